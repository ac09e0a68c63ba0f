"""Between samples of task space: through poses with their twists and accelerations, and rates from poses alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from taut.base.types import Float64Array
from taut.control.trajectories.timing import quintic_between
from taut.maths.spatial import exp_rows, from_body_rates, log_rows, to_body_rates

__all__ = ["TaskRows", "between", "differences", "faded", "offset"]

TaskRows = Mapping[str, Float64Array]
"""Fields of TaskMotion by name, each with one row per time: p, R, twist, acceleration, in world axes."""

Offset = tuple[Float64Array, Float64Array, Float64Array]


def between(times: Float64Array, knots: Float64Array, rows: TaskRows) -> dict[str, Float64Array]:
    """Each field at many times, from rows at the knots; at rest before the first and after the last.

    From one knot to the next the position is the quintic with the given velocities and accelerations at both ends; so
    is the rotation vector from the orientation at the one to that at the other, which is slerp where both turn at the
    mean rate. Twist and acceleration are the rates of that motion.
    """
    if len(knots) == 1:
        zero = np.zeros((len(times), 6))
        places = np.zeros(len(times), dtype=np.intp)
        return {"p": rows["p"][places], "R": rows["R"][places], "twist": zero, "acceleration": zero.copy()}
    i = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
    h = (knots[i + 1] - knots[i])[:, np.newaxis]
    x = np.clip((times - knots[i]) / h[:, 0], 0.0, 1.0)
    linear = [tuple(part[i + end] for part in _linear(rows)) for end in (0, 1)]
    p, v, a = quintic_between(x, h, *linear)  # type: ignore[arg-type]  # tuples of three
    ends = _pieces(knots, rows)
    r = quintic_between(x, h, *[tuple(part[i] for part in end) for end in ends])  # type: ignore[arg-type]
    R = rows["R"][i] @ exp_rows(r[0])
    omega, alpha = (_turned(R, part) for part in to_body_rates(*r))
    out = {"p": p, "R": R, "twist": np.hstack([v, omega]), "acceleration": np.hstack([a, alpha])}
    outside = (times < knots[0]) | (times > knots[-1])
    for name in ("twist", "acceleration"):
        out[name][outside] = 0.0
    return out


def _linear(rows: TaskRows) -> Offset:
    return rows["p"], rows["twist"][:, :3], rows["acceleration"][:, :3]


def _pieces(knots: Float64Array, rows: TaskRows) -> tuple[Offset, Offset]:
    """The rotation vector from each knot's orientation and its rates: at the knot, and at the next one."""
    R = rows["R"]
    omega, alpha = (_turned_back(R, rows[name][:, 3:]) for name in ("twist", "acceleration"))
    reach = log_rows(R[:-1].transpose(0, 2, 1) @ R[1:])
    start = np.zeros((len(knots) - 1, 3)), omega[:-1], alpha[:-1]
    return start, (reach, *from_body_rates(reach, omega[1:], alpha[1:]))


def differences(times: Float64Array, p: Float64Array, R: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Twists and accelerations (k, 6) from poses alone: central differences, one-sided at the ends."""
    if len(times) == 1:
        return np.zeros((1, 6)), np.zeros((1, 6))
    h = np.diff(times)[:, np.newaxis]
    slopes = log_rows(R[:-1].transpose(0, 2, 1) @ R[1:]) / h  # in the axes of both ends
    omega = np.vstack([slopes[:1], (h[1:] * slopes[:-1] + h[:-1] * slopes[1:]) / (h[1:] + h[:-1]), slopes[-1:]])
    twist = np.hstack([np.gradient(p, times, axis=0), _turned(R, omega)])
    return twist, np.gradient(twist, times, axis=0)


# -------------------------------------------------------------------- from one motion to another


def offset(old: TaskRows, new: TaskRows) -> tuple[Offset, Offset]:
    """What leads from a new motion to an old one at one instant: of the position, and of the rotation as exp(r).

    Args:
        old: One row of each field.
        new: One row of each field.
    """
    linear = tuple(a - b for a, b in zip(_linear(old), _linear(new), strict=True))
    back = new["R"].transpose(0, 2, 1) @ old["R"]
    omega, alpha = (_turned_back(old["R"], old[name][:, 3:]) for name in ("twist", "acceleration"))
    omega_new, alpha_new = (_turned_back(new["R"], new[name][:, 3:]) for name in ("twist", "acceleration"))
    seen, seen_rate = _turned_back(back, omega_new), _turned_back(back, alpha_new)
    # In the axes of the old one, with w = omega - seen: seen' = seen_rate - w x seen.
    w = omega - seen
    r = log_rows(back)
    return linear, (r, *from_body_rates(r, w, alpha - seen_rate + np.cross(w, seen)))  # type: ignore[return-value]


def faded(rows: TaskRows, x: Float64Array, duration: float, start: tuple[Offset, Offset]) -> dict[str, Float64Array]:
    """A motion with an offset that fades: all of it at x = 0, none from x = 1 on.

    Args:
        rows: The motion, (k, ...) by field.
        x: (k,) share of the fade that has passed, 0 to 1.
        duration: [s] of the fade.
        start: The offset at x = 0, as `offset` gives it.
    """
    none = (np.zeros((1, 3)),) * 3
    p, v, a = quintic_between(x, duration, start[0], none)
    r = quintic_between(x, duration, start[1], none)
    turn = exp_rows(r[0])
    w, w_rate = to_body_rates(*r)
    seen, seen_rate = (
        _turned_back(turn, _turned_back(rows["R"], rows[name][:, 3:])) for name in ("twist", "acceleration")
    )
    R = rows["R"] @ turn
    omega, alpha = _turned(R, seen + w), _turned(R, seen_rate + w_rate - np.cross(w, seen))
    return {
        "p": rows["p"] + p,
        "R": R,
        "twist": np.hstack([rows["twist"][:, :3] + v, omega]),
        "acceleration": np.hstack([rows["acceleration"][:, :3] + a, alpha]),
    }


def _turned(R: Float64Array, x: Float64Array) -> Float64Array:
    """R x, row by row."""
    out: Float64Array = np.einsum("kij,kj->ki", R, x)
    return out


def _turned_back(R: Float64Array, x: Float64Array) -> Float64Array:
    """R^T x, row by row."""
    out: Float64Array = np.einsum("kji,kj->ki", R, x)
    return out
