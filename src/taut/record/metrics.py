"""Metrics: how well a run went, in numbers, each defined once.

Errors are wanted minus true. A torque acts unchanged from its tick to the next, so integrals over time are sums.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.angles import short_way
from taut.base.checks import read_only
from taut.base.named import Named
from taut.base.types import Float64Array
from taut.control.limiting import LIMIT_TERMS
from taut.control.trajectories.task_reference import TaskMotion
from taut.record.felt import felt_measures
from taut.record.force import force_error
from taut.record.info import LIMITS, TOOL
from taut.record.pressed import pressed_measures
from taut.record.step import step_response
from taut.record.sticking import reversal_error, stuck

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = [
    "MEASURES",
    "OF_FORCE",
    "OF_JOINT_MOTION",
    "OF_STEPS",
    "OF_TASK_MOTION",
    "Measure",
    "Metrics",
    "metrics_of",
]


@dataclass(frozen=True, kw_only=True)
class Measure:
    """What one of the metrics is called, its unit, and how it is put together for all joints."""

    title: str
    unit: str  # {q} stands for rad or m, {tau} for N m or N, {command} for the command's unit
    overall: str  # in words; of the tool, what it is
    per_joint: bool = True  # else one number of the run, about the tool

    @property
    def per_unit(self) -> bool:
        """Whether joints in rad and joints in m have no common number of it."""
        return "{" in self.unit


def of_tool(title: str, unit: str, words: str) -> Measure:
    """A number of the tool, of which a run has one."""
    return Measure(title=title, unit=unit, overall=words, per_joint=False)


MEASURES: Final = {
    "overshoot": Measure(title="overshoot", unit="%", overall="the largest"),
    "settling_time": Measure(title="settling time", unit="s", overall="the latest"),
    "steady_state_error": Measure(title="steady-state error", unit="%", overall="the largest, with its sign"),
    "rms_error": Measure(title="RMS error", unit="{q}", overall="RMS of the error's norm"),
    "peak_error": Measure(title="peak error", unit="{q}", overall="peak of the error's norm"),
    "final_error": Measure(title="final error", unit="{q}", overall="norm of the final error"),
    "stuck_time": Measure(title="stuck", unit="s", overall="time in which any joint was stuck"),
    "reversal_error": Measure(title="reversal error", unit="{q}", overall="the largest"),
    "effort": Measure(title="effort", unit="({tau})^2 s", overall="the sum"),
    "peak_torque": Measure(title="peak torque", unit="{tau}", overall="the largest"),
    "saturation_time": Measure(title="saturated", unit="s", overall="time in which any joint's command was cut"),
    "rate_limit_time": Measure(title="rate limited", unit="s", overall="time in which any joint's rate was cut"),
    "speed_limit_time": Measure(title="speed limited", unit="s", overall="time in which any joint's speed was"),
    "torque_limit_time": Measure(title="torque limited", unit="s", overall="time in which any joint's torque was"),
    "blend_time": Measure(title="blending", unit="s", overall="time in which any joint's command was blended"),
    "largest_cut": Measure(title="largest cut", unit="{command}", overall="the largest"),
    "chatter": Measure(title="chatter", unit="{tau}/s", overall="the sum"),
    "energy": Measure(title="energy", unit="J", overall="the sum"),
    "torque_jump": Measure(title="torque jump", unit="{tau}", overall="the largest"),
    "torque_use": Measure(title="torque", unit="% of limit", overall="the largest"),
    "speed_use": Measure(title="speed", unit="% of limit", overall="the largest"),
    "final_x": of_tool("final x", "m", "where the tool is at the end, along the world's x axis"),
    "final_y": of_tool("final y", "m", "where the tool is at the end, along the world's y axis"),
    "final_z": of_tool("final z", "m", "where the tool is at the end, along the world's z axis"),
    "sideways_rms": of_tool("sideways RMS", "m/s", "RMS speed of the tool's origin along its own y axis"),
    "task_rms": of_tool("task RMS", "m", "RMS of the norm of the tool's position error"),
    "task_peak": of_tool("task peak", "m", "peak of the norm of the tool's position error"),
    "task_final": of_tool("task final", "m", "norm of the tool's position error in the last tick"),
    "task_rms_rotation": of_tool("rotation RMS", "rad", "RMS of the angle of the tool's rotation error"),
    "task_peak_rotation": of_tool("rotation peak", "rad", "peak of the angle of the tool's rotation error"),
    "least_singular_value": of_tool("least singular", "1", "the smallest singular value of J in the run"),
    "least_force": of_tool("least force", "N", "the least norm of the environment's force"),
    "force_rms": of_tool("force RMS", "N", "RMS of the norm of the environment's force"),
    "peak_force": of_tool("peak force", "N", "peak of the norm of the environment's force"),
    "peak_moment": of_tool("peak moment", "N m", "peak of the norm of the environment's moment"),
    "moment_rms": of_tool("moment RMS", "N m", "RMS of the norm of the environment's moment"),
    "force_error_rms": of_tool(
        "force error RMS", "N", "RMS of the norm of the error of the force that the arm applies"
    ),
    "force_error_peak": of_tool("force error peak", "N", "peak of the norm of that error"),
    "moment_error_rms": of_tool(
        "moment error RMS", "N m", "RMS of the norm of the error of the moment that the arm applies"
    ),
    "moment_error_peak": of_tool("moment error peak", "N m", "peak of the norm of that error"),
    "press_rms": of_tool("press error RMS", "N", "RMS of the error of the force along the true normal"),
    "press_peak": of_tool("press error peak", "N", "peak of the error of the force along the true normal"),
    "largest_press": of_tool("largest press", "N", "peak of the force along the true normal"),
    "surface_rms": of_tool("path error RMS", "m", "RMS of the tool's position error along the true surface"),
    "surface_peak": of_tool("path error peak", "m", "peak of the tool's position error along the true surface"),
    "normal_error": of_tool("normal error", "deg", "angle between the normal of the law and the true one at the end"),
    "contact_lost_time": of_tool("contact lost", "s", "time in which the tool met less than was asked for"),
    "impedance_error": of_tool("against eq. 10.48", "%", "RMS difference to eq. 10.48 integrated, of its RMS"),
    "felt_mass": of_tool("felt mass", "kg", "m of F_ext - K x = m a + b v, by least squares"),
}


OF_STEPS: Final = ("overshoot", "settling_time", "steady_state_error")  # which only a set-point has
OF_JOINT_MOTION: Final = (*OF_STEPS, "rms_error", "peak_error", "final_error", "stuck_time", "reversal_error")
OF_FORCE: Final = ("force_error_rms", "force_error_peak", "moment_error_rms", "moment_error_peak")
OF_PRESSING: Final = ("press_rms", "press_peak", "surface_rms", "surface_peak", "normal_error")
OF_TASK_MOTION: Final = (
    "task_rms",
    "task_peak",
    "task_final",
    "task_rms_rotation",
    "task_peak_rotation",
    "least_singular_value",
    "impedance_error",
    "felt_mass",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Metrics:
    """How well a run went, in numbers per joint by attribute, for all joints in `overall`, and per unit in `groups`.

    NaN (null in JSON) where a number has no meaning: overshoot, settling time and steady-state error where the
    reference is not constant, or where a joint had no initial error; saturation where nothing limits the command;
    stuck time and reversal error where the reference does not move, or never turns round; errors of joints where
    the reference is one of the task, and the task's where it is one of joints; forces where none are recorded, and
    their errors where none are asked for;
    shares of limits that the arm does not state; what was felt where the law promises no impedance, its gains
    change, or nothing moves the tool; an overall number of joints with different units, each of which has its
    number in `groups`.

    Attributes:
        overshoot: (n,) [%] of the initial error, beyond where the joint came to rest (chapter, below figure 10.4).
        settling_time: (n,) [s] after which the error stays within 2 % of where it came to rest, interpolated
            between ticks; inf if it had not come to rest when the run ended.
        steady_state_error: (n,) [%] of the initial error that is left: mean of the last 2 % of the run.
        rms_error: (n,) [rad | m] root of the mean square of the tracking error.
        peak_error: (n,) [rad | m] largest magnitude of the tracking error.
        final_error: (n,) [rad | m] tracking error of the last tick.
        stuck_time: (n,) [s] in which the joint rests, slower than 1e-4 rad/s | m/s, while its reference moves,
            faster than 1e-3: stick-slip, and the rest after each reversal.
        reversal_error: (n,) [rad | m] largest magnitude of the tracking error after the reference began to move the
            other way, faster than 1e-3 rad/s | m/s, until halfway to its next reversal.
        effort: (n,) [(N m)^2 s | N^2 s] integral of tau^2, as in figure 10.12.
        peak_torque: (n,) [N m | N] largest magnitude of tau.
        saturation_time: (n,) [s] in which the limits cut the command.
        rate_limit_time: (n,) [s] in which the limit of the torque rate did.
        speed_limit_time: (n,) [s] in which the speed limit did.
        torque_limit_time: (n,) [s] in which the limit of the torque did.
        blend_time: (n,) [s] in which a change was blended in.
        largest_cut: (n,) [N m | N] largest magnitude that the limits took away, in the command's unit.
        chatter: (n,) [N m/s | N/s] total variation of tau per second.
        energy: (n,) [J] work of tau on the joint, integral of tau v.
        torque_jump: (n,) [N m | N] largest jump of tau: how far its change in a tick is at least off those in the
            ticks before and after. A continuous torque has next to none, however steep.
        torque_use: (n,) [%] largest magnitude of tau, of the arm's effort limit.
        speed_use: (n,) [%] largest magnitude of the speed, of the arm's velocity limit.
        task_rms: [m] root of the mean square of the tool's distance from where it should be.
        task_peak: [m] its largest.
        task_final: [m] that of the last tick.
        task_rms_rotation: [rad] root of the mean square of the angle of log(R_des R^T).
        task_peak_rotation: [rad] its largest.
        final_x: [m] where the tool is in the last tick, in the world; final_y and final_z likewise.
        final_y: [m]
        final_z: [m]
        sideways_rms: [m/s] root of the mean square of the speed of the tool's origin along its own y axis.
        least_singular_value: The smallest singular value of the tool's Jacobian in the run, metres and radians taken
            as alike; 0 at a singularity.
        least_force: [N] smallest force of the environment on the arm; force_rms: root of its mean square.
        force_rms: [N]
        peak_force: [N] largest force of the environment on the arm.
        peak_moment: [N m] its largest moment at the tool.
        moment_rms: [N m] RMS of that moment.
        force_error_rms: [N] root of the mean square of the force's error: wanted less applied, both of the arm on the
            environment at the tool. Over the whole run; `run.between(start, end).metrics` has those of a window.
        force_error_peak: [N] the largest of that error.
        moment_error_rms: [N m] the same of the moment at the tool's origin.
        moment_error_peak: [N m]
        press_rms: [N] root of the mean square of the error of the force into a surface: `press`, or the part of F_app
            along the true normals, less what the contacts give along these, which a MujocoPlant with a scene tells;
            NaN where the force was asked for as `lam`.
        press_peak: [N] its largest.
        largest_press: [N] the largest force along the true normals, such as of an impact.
        surface_rms: [m] root of the mean square of the tool's position error across the true normal, in contact.
        surface_peak: [m] its largest.
        normal_error: [deg] angle between the estimated normal and the true one, when the tool last touched.
        contact_lost_time: [s] in which a law of force measured less than counts as contact while more was asked for.
        impedance_error: [%] RMS distance of the tool from where eq. 10.48, integrated with the run's own F_ext and
            the law's K, B and D, puts it; of that equation's RMS deviation. Without D the inertia, and with zeta the
            damping, is that at the start.
        felt_mass: [kg] m of F_ext - K x = m a + b v, by least squares over ticks and directions, K being the law's;
            where that asks for one mass in every direction.
        overall: One number of each for all joints together; `MEASURES[name].overall` says which.
        groups: The same for the joints of each unit: {"rad": {"rms_error": ...}, "m": {"rms_error": ...}}.

    References:
        Chapter, section 10.2.1.1, figure 10.4 (overshoot, settling time, steady-state error); figure 10.12 (effort).
    """

    joint_names: tuple[str, ...]
    units: dict[str, tuple[str, ...]]  # of each metric, joint by joint
    duration: float  # [s]
    setpoint: bool  # whether the reference is constant
    overshoot: Float64Array
    settling_time: Float64Array
    steady_state_error: Float64Array
    rms_error: Float64Array
    peak_error: Float64Array
    final_error: Float64Array
    stuck_time: Float64Array
    reversal_error: Float64Array
    effort: Float64Array
    peak_torque: Float64Array
    saturation_time: Float64Array
    rate_limit_time: Float64Array
    speed_limit_time: Float64Array
    torque_limit_time: Float64Array
    blend_time: Float64Array
    largest_cut: Float64Array
    chatter: Float64Array
    energy: Float64Array
    torque_jump: Float64Array
    torque_use: Float64Array
    speed_use: Float64Array
    task_rms: float
    task_peak: float
    task_final: float
    task_rms_rotation: float
    task_peak_rotation: float
    final_x: float
    final_y: float
    final_z: float
    sideways_rms: float
    least_singular_value: float
    least_force: float
    force_rms: float
    peak_force: float
    peak_moment: float
    moment_rms: float
    force_error_rms: float
    force_error_peak: float
    moment_error_rms: float
    moment_error_peak: float
    press_rms: float
    press_peak: float
    largest_press: float
    surface_rms: float
    surface_peak: float
    normal_error: float
    contact_lost_time: float
    impedance_error: float
    felt_mass: float
    overall: dict[str, float]
    groups: dict[str, dict[str, float]]

    def unit(self, name: str, group: str | None = None) -> str:
        """Unit of a metric, of a group if one is named; of joints with different units, both."""
        if not MEASURES[name].per_joint:
            return MEASURES[name].unit
        places = zip(self.units["rms_error"], self.units[name], strict=True)
        return " | ".join(dict.fromkeys(unit for of, unit in places if group in (None, of)))

    def by_unit(self, name: str, joint: str | None = None) -> dict[str, float]:
        """A metric by its unit: of one joint; or the overall number, or one for each group where there is none.

        Args:
            name: The metric.
            joint: The joint; it makes no difference to a number of the tool.
        """
        if joint is not None and MEASURES[name].per_joint:
            i = self.joint_names.index(joint)
            return {self.units[name][i]: float(getattr(self, name)[i])}
        if len(self.groups) == 1 or not MEASURES[name].per_unit:
            return {self.unit(name): self.overall[name]}
        return {self.unit(name, group): numbers[name] for group, numbers in self.groups.items()}

    def json(self) -> dict[str, Any]:
        """As plain values: {"duration", "setpoint", "rms_error": {"unit", "overall", "groups", "joints"}, ...}."""
        out: dict[str, Any] = {"duration": {"unit": "s", "overall": self.duration}, "setpoint": self.setpoint}
        for name, measure in MEASURES.items():
            if not measure.per_joint:
                out[name] = {"unit": measure.unit, "overall": _plain(self.overall[name])}
                continue
            per_joint = zip(self.joint_names, getattr(self, name), strict=True)
            out[name] = {
                "unit": self.unit(name),
                "overall": _plain(self.overall[name]),
                "groups": {
                    group: {"unit": self.unit(name, group), "overall": _plain(numbers[name])}
                    for group, numbers in self.groups.items()
                },
                "joints": {joint: _plain(value) for joint, value in per_joint},
            }
        return out

    def __str__(self) -> str:
        from taut.record.table import metrics_table

        return metrics_table(self)


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# -------------------------------------------------------------------- one run


def metrics_of(run: Run) -> Metrics:
    """The metrics of a run."""
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverged may hold huge numbers
        setpoint = _is_setpoint(run)
        columns = _per_joint(run, setpoint)
        overall = _together(run, columns, list(range(run.n)))
        groups: dict[str, dict[str, float]] = {
            unit: Named("a run", "metric", _together(run, columns, [i for i in range(run.n) if run.units[i] == unit]))
            for unit in dict.fromkeys(run.units)
        }
        tool = _of_tool(run)
    if len(groups) > 1:
        overall |= {name: np.nan for name, measure in MEASURES.items() if measure.per_unit}
    values: dict[str, Any] = {name: read_only(numbers) for name, numbers in columns.items()}
    return Metrics(
        joint_names=run.joint_names,
        units={name: _units(run, measure.unit) for name, measure in MEASURES.items() if measure.per_joint},
        duration=float(run.t[-1] - run.t[0]) if len(run) else 0.0,
        setpoint=setpoint,
        overall=Named("a run", "metric", overall | tool),
        groups=Named("a run", "group of joints, by unit,", groups),
        **values,
        **tool,
    )


def _units(run: Run, text: str) -> tuple[str, ...]:
    rows = zip(run.units, run.effort_units, run.command_units, strict=True)
    return tuple(text.format(q=q, tau=tau, command=command).replace("(N)^2", "N^2") for q, tau, command in rows)


def _per_joint(run: Run, setpoint: bool) -> dict[str, Float64Array]:
    columns = {name: np.full(run.n, np.nan) for name, measure in MEASURES.items() if measure.per_joint}
    if not len(run):
        return columns
    error = run.error
    if error is not None:
        columns |= {name: number(error) for name, number in NORMS.items()}
    if error is not None and setpoint:
        steps = [step_response(run.t, error[:, i]) for i in range(run.n)]
        columns |= {name: np.array([getattr(step, name) for step in steps]) for name in OF_STEPS}
    resting = stuck(run)
    if resting is not None:
        columns["stuck_time"] = np.sum(resting[:-1] * np.diff(run.t)[:, np.newaxis], axis=0)
    columns["reversal_error"] = reversal_error(run)
    return columns | _of_torque(run) | _of_limits(run)


def _together(run: Run, columns: Mapping[str, Float64Array], joints: list[int]) -> dict[str, float]:
    """One number of each metric for some joints."""
    chosen = {name: values[joints] for name, values in columns.items()}
    numbers = {name: float(np.sum(chosen[name])) for name in ("effort", "chatter", "energy")}
    numbers |= {name: float(np.max(chosen[name])) for name in ("peak_torque", "largest_cut", "torque_jump")}
    numbers |= {name: _worst(chosen[name]) for name in (*OF_STEPS, "reversal_error", "torque_use", "speed_use")}
    numbers |= dict.fromkeys((*NORMS, *TIMES, "stuck_time"), np.nan)
    resting = stuck(run) if len(run) else None
    if resting is not None and not np.isnan(chosen["stuck_time"]).all():
        numbers["stuck_time"] = float(np.sum((resting[:-1, joints] == 1.0).any(axis=1) * np.diff(run.t)))
    if len(run) and run.error is not None:
        norm = np.sqrt(np.sum(run.error[:, joints] ** 2, axis=1))
        numbers |= {name: float(number(norm)) for name, number in NORMS.items()}
    for name, value in _acting(run).items() if len(run) else ():
        numbers[name] = float(np.sum((value[:-1, joints] != 0.0).any(axis=1) * np.diff(run.t)))
    return {name: numbers[name] for name, measure in MEASURES.items() if measure.per_joint}


def _of_tool(run: Run) -> dict[str, Any]:
    """Everything about the tool: where it should be, and what pushes it."""
    out: dict[str, Any] = {name: np.nan for name, measure in MEASURES.items() if not measure.per_joint}
    if not len(run):
        return out
    if TOOL in run.info:
        out |= {f"final_{axis}": float(value) for axis, value in zip("xyz", run.task.p[-1], strict=True)}
        out["sideways_rms"] = float(_rms(np.sum(run.task.R[:, :, 1] * run.task.twist[:, :3], axis=1)))
    if isinstance(run.reference.motion, TaskMotion) and TOOL in run.info:
        task = run.task
        errors = {"": task.position_error, "_rotation": task.rotation_error}
        for what, error in errors.items():
            assert error is not None
            size = np.linalg.norm(error, axis=1)
            out |= {f"task_rms{what}": float(_rms(size)), f"task_peak{what}": float(_peak(size))}
        assert task.position_error is not None
        out["task_final"] = float(np.linalg.norm(task.position_error[-1]))
        out["least_singular_value"] = float(task.least_singular_value.min())
    if "F_ext" in run.extra:
        wrench = run.extra["F_ext"]
        size = np.linalg.norm(wrench[:, :3], axis=1)
        out |= {"least_force": float(size.min()), "force_rms": float(_rms(size))}
        for name, part in (("peak_force", wrench[:, :3]), ("peak_moment", wrench[:, 3:])):
            out[name] = float(np.linalg.norm(part, axis=1).max())
        out["moment_rms"] = float(_rms(np.linalg.norm(wrench[:, 3:], axis=1)))
    error = force_error(run)
    if error is not None:
        for name, part in (("force", error[:, :3]), ("moment", error[:, 3:])):
            size = np.linalg.norm(part, axis=1)
            out |= {f"{name}_error_rms": float(_rms(size)), f"{name}_error_peak": float(_peak(size))}
    lost = [column for name, column in run.extra.items() if name.startswith("law.") and name.endswith(".lost")]
    if lost:
        told = np.any([column > 0.0 for column in lost], axis=0)  # NaN where the law's phase does not act
        out["contact_lost_time"] = float(np.sum(told[:-1] * np.diff(run.t)))
    return out | pressed_measures(run) | felt_measures(run)


def _rms(x: Float64Array) -> Float64Array:
    root: Float64Array = np.sqrt(np.mean(x**2, axis=0))
    return root


def _peak(x: Float64Array) -> Float64Array:
    peak: Float64Array = np.max(np.abs(x), axis=0)
    return peak


def _final(x: Float64Array) -> Float64Array:
    final: Float64Array = x[-1]
    return final


TIMES: Final = {
    "saturation_time": "",
    **{f"{term}_time": term for term in (*LIMIT_TERMS, "blend")},
}
NORMS: Final = {"rms_error": _rms, "peak_error": _peak, "final_error": _final}


def _is_setpoint(run: Run) -> bool:
    """Whether the reference asks for one position throughout."""
    q, v = getattr(run.reference, "q", None), getattr(run.reference, "v", None)
    return q is not None and bool(len(run)) and not np.any(q != q[0]) and not np.any(v)


def _worst(values: Float64Array) -> float:
    values = values[~np.isnan(values)]
    return float(values[np.argmax(np.abs(values))]) if values.size else np.nan


def _of_limits(run: Run) -> dict[str, Float64Array]:
    """Peaks in percent of the arm's own limits, where it has them."""
    out = {}
    for name, rows, limit in (("torque_use", run.tau, "effort"), ("speed_use", run.v, "velocity")):
        limits: Mapping[str, float] = run.info.get(LIMITS, {}).get(limit, {})
        out[name] = 100.0 * _peak(rows) / np.array([limits.get(joint, np.nan) for joint in run.joint_names])
    return out


def _of_torque(run: Run) -> dict[str, Float64Array]:
    """Everything about torque, joint by joint."""
    dt = np.diff(run.t)[:, np.newaxis]  # (k - 1, 1) how long each row's torque acted [s]
    duration = float(dt.sum())
    acting = run.tau[:-1]
    out = {
        "effort": np.sum(acting**2 * dt, axis=0),
        "peak_torque": _peak(run.tau),
        # A torque that is constant over the period does the work tau (q_next - q), whatever v does in between.
        "energy": np.sum(acting * short_way(np.diff(run.q, axis=0), run.continuous), axis=0),
    }
    if len(run) > 3:
        steps = np.diff(run.tau, axis=0)
        before, after = (np.abs(steps[1:-1] - beside) for beside in (steps[:-2], steps[2:]))
        out["torque_jump"] = _peak(np.minimum(before, after))
    if duration:
        out["chatter"] = np.sum(np.abs(np.diff(run.tau, axis=0)), axis=0) / duration
    for name, value in _acting(run).items():
        out[name] = np.sum((value[:-1] != 0.0) * dt, axis=0)
    cuts = [run.terms[name] for name in LIMIT_TERMS if name in run.terms]
    return out | ({"largest_cut": _peak(np.sum(cuts, axis=0))} if cuts else {})


def _acting(run: Run) -> dict[str, Float64Array]:
    """(k, n) what limits and blend added to the command, by the metric that says how long."""
    parts = {name: run.terms[term] for name, term in TIMES.items() if term in run.terms}
    cuts = [parts[name] for name in parts if TIMES[name] in LIMIT_TERMS]
    if cuts:
        parts["saturation_time"] = np.any([cut != 0.0 for cut in cuts], axis=0).astype(np.float64)
    return parts
