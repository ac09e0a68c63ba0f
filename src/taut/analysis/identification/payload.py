"""Payload that an adaptive law has learned in a run, and what the motion did not excite and so could not teach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from taut.analysis.identification.regression import ArmRegression, linear_text
from taut.arm.description import Payload
from taut.base.checks import instance_of
from taut.base.errors import UsageError
from taut.base.result import Content, Result, Table
from taut.base.types import Float64Array
from taut.control.laws.other_topics.adaptive import metric
from taut.maths import regressor as rg
from taut.maths.model import PayloadValues, model_of
from taut.record.run import Run

ESTIMATE: Final = ".estimate"  # ends the column of a run
EXCITED: Final = 1e-5  # [-] of the largest eigenvalue, 1/300 in torque: below it a direction is not excited
CHANGING: Final = 0.05  # [-] of mass, centre of mass or inertia: an estimate that changes by more has not settled
NAMED: Final = 0.05  # [-] of the largest entry of a direction: smaller ones are not named


@dataclass(frozen=True, kw_only=True, eq=False)
class PayloadEstimate(Result):
    """What the tool carries by the estimate at the end of a run, and which directions of its parameters were excited.

    Eigenvalues are those of Q^1/2 W Q^1/2, W the mean of Y^T Y over the run with Y the tool body's columns of the
    regressor, and Q y how adaptation moves the parameters: directions with eigenvalues near zero are not learned.

    Frames:
        The tool frame; `com` is the payload's, `inertia` is about it. Parameters of directions are those of the
        whole body that carries the tool, about the tool's origin.
    """

    mass: float  # [kg]
    com: Float64Array  # (3,) [m]; NaN where the mass is not positive
    inertia: Float64Array  # (6,) [kg m^2] xx, yy, zz, xy, xz, yz
    moving: Float64Array  # (10,) change of mass, com and inertia in the last quarter of the run
    excited: NDArray[np.bool_]  # (10,) of mass, com and inertia: no direction that was not excited has a part of it
    eigenvalues: Float64Array  # (10,) [N^2 m^2], the largest first
    not_excited: Float64Array  # (j, 10) directions of the parameters [kg, kg m, kg m^2]
    directions: tuple[str, ...]  # each as a sum: "h_z", "I_xx - 0.3 h_x"; the first parameter is in no other one

    @property
    def payload(self) -> Payload:
        """For `arm.with_payload` or `ctrl.parameters`.

        Raises:
            RangeError: Numbers that no payload has: the difference of two possible bodies may be none.
        """
        return Payload(mass=self.mass, com=self.com, inertia=self.inertia)

    @property
    def rank(self) -> int:
        """Number of directions that the run excited."""
        return len(self.excited) - len(self.not_excited)

    def content(self) -> Content:
        """The payload, and the directions that were not excited."""
        names = ["mass [kg]", *(f"com {axis} [m]" for axis in "xyz")]
        names += [f"{name} [kg m^2]" for name in rg.PARAMETERS[4:]]
        values = map(float, (self.mass, *self.com, *self.inertia))
        sizes = np.repeat([abs(self.mass), np.linalg.norm(self.com), np.linalg.norm(self.inertia)], [1, 3, 6])
        changing = np.abs(self.moving) > CHANGING * sizes
        words = ("yes, still changing" if moves else "yes" for moves in changing)
        excited = (word if known else "no" for word, known in zip(words, self.excited, strict=True))
        found = f"the motion excited {self.rank} of 10 directions of the parameters"
        if self.directions:
            found += "; not excited, and so never learned: " + "; ".join(self.directions)
        return Content(
            title="payload by the estimate at the end of the run, in the tool frame",
            summary=[found],
            tables=[
                Table(
                    columns=("quantity", "estimate", "changed in the last quarter by", "excited"),
                    rows=list(zip(names, values, map(float, self.moving), excited, strict=True)),
                ),
                Table(title="excitation", columns=("eigenvalue [N^2 m^2]",), rows=[(x,) for x in self.eigenvalues]),
            ],
            notes=[
                "h is mass times centre of mass, I about the tool's origin, both of the whole body that carries the "
                "tool; the payload is its difference to the model's, and may be impossible where it was not excited",
            ],
        )


def payload_estimate(run: Run) -> PayloadEstimate:
    """The payload that `taut.laws.Adaptive` has learned by the end of a run, and what the run did not excite.

    It is the estimated body less the model's own. `run.between(start, end)` is the motion since it was picked up.

    Args:
        run: A run of the law.

    Raises:
        UsageError: No run of an adaptive law, or one that does not know its controller's arm.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.Adaptive(lam=10.0, k=10.0, gamma=5.0, max_payload=2.0), arm)
        >>> wave = taut.trajectories.Sine(center=[0.0, 0.0], amplitude=[0.8, 0.6], frequency=[0.5, 0.7])
        >>> run = taut.run(ctrl, taut.RigidPlant(arm.with_payload(1.0), friction=None), wave, duration=8.0)
        >>> found = payload_estimate(run)
        >>> round(found.mass, 2), found.rank
        (0.93, 3)
    """
    instance_of("run", run, Run, "a Run of taut.run")
    arm = run.info.controller_arm
    columns = [name for name in run.extra if name.endswith(ESTIMATE)]
    if len(columns) != 1 or arm is None:
        raise UsageError(
            "payload_estimate is for a run of one taut.laws.Adaptive, and this run records "
            f"{len(columns) or 'no'} estimates; run the law alone, or load the log of such a run",
            name="run",
        )
    model, regression = model_of(arm), ArmRegression(arm, ("payload",))
    k, R, p = model.placement(None)
    to_tool, estimates = np.linalg.inv(rg.moved(R, p)), run.extra[columns[0]].reshape(len(run), -1, 10)
    bodies = estimates[:, 0 if estimates.shape[1] == 1 else k] @ to_tool.T
    body, own = bodies[-1], to_tool @ rg.parameters_of(model.links[k])
    load, before = (PayloadValues.of_body(rg.body_of(x - own)) for x in (body, bodies[3 * len(run) // 4]))
    now, then = (np.array([x.mass, *x.com, *x.inertia]) for x in (load, before))
    Q, a = metric(body), getattr(run.reference, "a", np.zeros_like(run.q))
    Y = regression.columns(run.q, run.v, a)[0].reshape(-1, 10)
    root, sizes = np.linalg.cholesky(Q), np.sqrt(np.diag(Q))
    values, vectors = np.linalg.eigh(root.T @ (Y.T @ Y / len(run)) @ root)
    directions = _readable((root @ vectors[:, values <= EXCITED * values[-1]]).T / sizes)
    named = (np.argsort(-np.abs(each), kind="stable")[: np.sum(np.abs(each) >= NAMED)] for each in directions)
    known = np.all(np.abs(directions) < NAMED, axis=0)
    known[1:] &= known[0]  # the centre of mass is h / m, and the inertia is about it
    known[4:] &= known[[[2, 3], [1, 3], [1, 2], [1, 2], [1, 3], [2, 3]]].all(axis=1)
    return PayloadEstimate(
        mass=float(load.mass),
        com=load.com,
        inertia=load.inertia,
        moving=now - then,
        excited=known,
        eigenvalues=values[::-1].copy(),
        not_excited=directions * sizes,
        directions=tuple(
            linear_text([(each[i], rg.PARAMETERS[i]) for i in which])
            for each, which in zip(directions, named, strict=True)
        ),
    )


def _readable(directions: Float64Array) -> Float64Array:
    """(j, 10) directions that span the same, each with 1 for a parameter that the others have nothing of."""
    if not len(directions):
        return directions
    *_, order = qr(directions, pivoting=True)
    return np.asarray(np.linalg.solve(directions[:, order[: len(directions)]], directions), dtype=np.float64)
