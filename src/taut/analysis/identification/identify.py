"""taut.analysis.identify: payload, friction, rotors and links of an arm from recorded runs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.analysis.identification.least_squares import SIGNIFICANT, UNCERTAIN, Fit, Samples
from taut.analysis.identification.regression import ArmRegression, Unknown, changed_arm, possible_bodies
from taut.base.checks import instance_of, positive_scalar
from taut.base.errors import NumericalError, UsageError, quoted_list
from taut.base.paths import Named
from taut.base.plot_style import DASHED, SMALL, WIDTH, colour, prepared
from taut.base.result import Content, Result, Table, Uncertain
from taut.base.types import Float64Array
from taut.control.trajectories.reference import JointMotion
from taut.controller import Controller
from taut.linear.linearise import linearise
from taut.loop import Loop
from taut.plant.rigid import RigidPlant
from taut.record.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.arm.description import Arm

CONFIDENCE: Final = 1.96  # standard deviations of an interval of 95 %
EXACT: Final = 1e-2  # standard deviations between the estimate and a possible body, by the search for it
IMPOSSIBLE: Final = 10.0  # the same of what no noise explains; test_torques_without_gravity_are_pointed_out
STICKS: Final = 10.0  # the reference moves a joint by so many times its motion
REMARKS: Final = {
    "uncertain": "uncertain by more than 20 %",
    "without_slow_motion": "static friction is not identifiable, for want of slow reversals, of",
    "without_effect": "no motion of this arm shows",
}


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """An identified number."""

    value: float
    std: float
    unit: str

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval."""
        return self.value - CONFIDENCE * self.std, self.value + CONFIDENCE * self.std


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdict:
    """Whether an identified model is good enough for a law."""

    ok: bool  # no joint's bound exceeds what is allowed
    bounds: Float64Array  # (n,) of the tracking error by torques that the model does not explain [rad | m]


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification(Result):
    """Identified parameters of an arm.

    Frames:
        The payload's parameters are about the tool's origin, in its axes; those of a link about the frame of its
        joint, in the axes of the arm.
    """

    arm: Arm  # with what was found; always a possible one
    estimates: Mapping[str, Estimate]  # "payload.m", "panda_joint1.viscous", ...; of base parameters the first name
    combinations: Mapping[str, str]  # what base parameters stand for, of those that stand for several
    condition: float  # of the regressor with columns of length 1
    uncertain: tuple[str, ...]  # parameters whose standard deviation is above 20 % of their size
    without_slow_motion: tuple[str, ...]  # joints whose static friction the record does not show
    without_effect: tuple[str, ...]  # parameters that act on no torque in any motion; they stay as the arm has them
    lag: float  # largest correlation of successive residuals of a joint; above 0.2 it widens all intervals
    distance: float  # from the estimate to the nearest possible body, which `arm` has [standard deviations]
    t: Float64Array  # (k,) times of the samples of all runs [s]
    measured: Float64Array  # (k, n) filtered torques at these [N m | N]; NaN where a joint with friction rests
    before: Float64Array  # (k, n) torques by the arm as it was
    after: Float64Array  # (k, n) torques by the arm with what was found
    torque_std: Float64Array  # (n,) largest standard deviation of a torque by uncertain parameters [N m | N]

    @property
    def physical(self) -> bool:
        """The estimate itself is that of possible bodies: pseudo-inertia positive definite."""
        return self.distance < EXACT

    @property
    def residual(self) -> tuple[Float64Array, Float64Array]:
        """RMS of the torques [N m | N] that the arm before and after does not explain."""
        return _rms(self.measured - self.before), _rms(self.measured - self.after)

    def verdict(self, ctrl: Controller, *, error: float) -> Verdict:
        """Whether the model is good enough for a law: the tracking error by torques that it does not explain.

        Law:          |e_i| <= sum over j of max over omega |T_ij(j omega)| d_j, T from joint torques to positions in
                      the sampled loop at home; d_j = RMS of the residual, which has the noise of the torques in it,
                      plus 1.96 standard deviations of the torque by uncertain parameters

        Args:
            ctrl: The controller that is to use the model: `taut.compile(law, found.arm)`.
            error: Largest tracking error that is allowed [rad | m].

        Raises:
            UsageError: A law that follows no joint positions, or whose loop is unstable.
        """
        instance_of("ctrl", ctrl, Controller, "a controller from taut.compile")
        if ctrl.side.law.reference is not JointMotion:
            raise UsageError("verdict is for laws that follow joint positions", name="ctrl")
        lin = linearise(Loop(ctrl, RigidPlant(self.arm, friction=None), JointMotion(q=self.arm.home), duration=1.0))
        gain = lin.peak_gain(input="disturbance.torque", output="q")
        bounds = gain @ (self.residual[1] + CONFIDENCE * self.torque_std)
        return Verdict(ok=bool((bounds <= positive_scalar("error", error, unit="rad | m")).all()), bounds=bounds)

    def content(self) -> Content:
        """Estimates with intervals, what is uncertain or not identifiable, and the torques."""
        summary = []
        if "payload.m" in self.estimates:
            com = ", ".join(f"{x:.4g}" for x in self.arm.payload.com)
            summary.append(f"payload {self.arm.payload.mass:.4g} kg, centre of mass ({com}) m")
        faults, away = [], f"{self.distance:.2g} standard deviations away"
        if self.distance >= IMPOSSIBLE:
            faults = [f"the nearest possible body is {away}: does the plant add gravity itself, is it another arm?"]
        elif not self.physical:
            summary.append(f"the arm has the nearest possible body, {away}; the estimate itself is of none")
        summary += [f"{text}: {', '.join(names)}" for name, text in REMARKS.items() if (names := getattr(self, name))]
        rows = [
            (name, Uncertain(each.value, half := CONFIDENCE * each.std), Uncertain(half, half), each.unit)
            for name, each in self.estimates.items()
        ]
        residual = list(zip(self.arm.joint_names, *(part.tolist() for part in self.residual), strict=True))
        heads = ("joint", "before [N m | N]", "after [N m | N]")
        tables = [
            Table(title="estimates", columns=("parameter", "value", "+- (95 %)", "unit"), rows=rows),
            Table(title="base parameters", columns=("name", "stands for"), rows=list(self.combinations.items())),
            Table(title="torque not explained, RMS", columns=heads, rows=residual),
        ]
        return Content(
            title=f"identification from {len(self.t)} samples",
            summary=summary,
            faults=faults,
            tables=[table for table in tables if table.rows],
            notes=[f"condition number {self.condition:.3g}; correlation of successive residuals {self.lag:.2g}"],
            figures={"torques": partial(_figure, self)},
        )


def identify(
    runs: Run | Sequence[Run], arm: Arm, *, what: Sequence[Unknown] = ("payload", "friction")
) -> Identification:
    """Payload, friction, rotor inertia or links of an arm from recorded motions in free space.

    Law:          tau - known torques = Y x, least squares in two passes, weights 1 / residual of each joint
                  Y at full rate from positions through a zero-phase filter (20 Hz); then Y and tau through the same
                  zero-phase filter (5 Hz), and one sample per 0.1 s; Cov = s^2 (Y^T W Y)^-1

    Measured positions and torques are used where the run has them (`sensed.q`, `sensed.tau_meas`), else true ones.

    Args:
        runs: One or several, of `taut.run` or `taut.load_run`; `taut.analysis.excitation` designs the motion.
        arm: The arm as far as it is known; what is not in `what` is taken from it.
        what: "payload", ten parameters of what the tool carries; "links", the base parameters of all bodies;
            "rotors", rotor inertias; "friction", viscous and Coulomb, and where the record holds slow reversals
            static and the Stribeck speed.

    Warns:
        RuntimeWarning: The condition number is above 30.

    Raises:
        NumericalError: Too little excitation; the joints that rest, or the direction that is excited least.
        UsageError, MatchError: Contact or a changing plant in the run; another arm; what that does not go together.
        RangeError: A record that is too short or too slow for the filters.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> plant = taut.RigidPlant(arm.with_friction(taut.Friction(viscous=0.2, coulomb=0.1)))
        >>> ctrl = taut.compile(taut.laws.ComputedTorque(kp=400.0, kd=40.0), arm)
        >>> run = taut.run(ctrl, plant, taut.analysis.excitation(arm, what=["friction"]), duration=20.0)
        >>> found = identify(run, arm, what=["friction"])
        >>> found.arm.viscous.round(2).tolist(), found.arm.coulomb.round(2).tolist()
        ([0.2], [0.1])

    References:
        Gautier and Khalil (1990), IEEE T-RA 6 (3): base parameters. Swevers et al. (1997), IEEE T-RA 13 (5). Rucker
        and Wensing (2022), IEEE RA-L 7 (2): possible bodies.
    """
    regression = ArmRegression(arm, what)
    given = [runs] if isinstance(runs, Run) else runs
    if not isinstance(given, Sequence) or not given or not all(isinstance(run, Run) for run in given):
        raise UsageError(f"runs must be a run of taut.run, or a list of some; got {runs!r}", name="runs")
    samples = [Samples(run, regression) for run in given]
    _require_motion(given, samples, regression)
    names, units = ([words[j] for j in regression.base] for words in (regression.names, regression.units))
    plain = Fit(samples, names)
    condition = plain.condition()
    slow, hidden = plain.slow_friction() if "friction" in regression.what else ({}, [])
    fit, b = Fit(samples, names, slow) if slow else plain, len(names)
    for word, of_hinge, of_slide in (("static", "N m", "N"), ("stribeck", "rad/s", "m/s")):
        names += [f"{arm.joint_names[i]}.{word}" for i in slow]
        units += [of_hinge if arm.units[i] == "rad" else of_slide for i in slow]
    numbers = zip(names, units, fit.x.tolist(), np.sqrt(np.diag(fit.covariance)).tolist(), strict=True)
    estimates = {name: Estimate(value=x, std=std, unit=unit) for name, unit, x, std in numbers}
    unknowns, distance = possible_bodies(regression, fit.x[:b], fit.covariance[:b, :b])
    mass = estimates.get("payload.m")
    if mass is not None and mass.value < SIGNIFICANT * mass.std:
        unknowns[:10] = 0.0  # no payload
    known, share = (np.concatenate([getattr(part, name) for part in samples]) for name in ("known", "share"))
    measured = known + plain.tau
    found = np.concatenate([regression.K @ unknowns, fit.x[b:]])
    return Identification(
        arm=changed_arm(regression, unknowns, dict(zip(slow, fit.x[b:].reshape(2, -1).T.tolist(), strict=True))),
        estimates=Named("the identification", "parameter", estimates),
        combinations=regression.combinations,
        condition=condition,
        uncertain=_uncertain(estimates),
        without_slow_motion=tuple(arm.joint_names[i] for i in hidden),
        without_effect=regression.without_effect,
        lag=fit.lag,
        distance=distance,
        t=np.concatenate([part.t for part in samples]),
        measured=measured / share,
        before=(known + plain.Y @ (regression.K @ regression.nominal)) / share,
        after=(measured - fit.tau + fit.Y @ found) / share,
        torque_std=np.sqrt(np.einsum("kib,bc,kic->ki", fit.Y, fit.covariance, fit.Y).max(axis=0)),
    )


def _require_motion(runs: Sequence[Run], samples: Sequence[Samples], regression: ArmRegression) -> None:
    """Refuse a record in which a joint rests whose friction or rotor is asked for, or in which all rest."""
    rests = ~np.any([part.moves for part in samples], axis=0)
    if rests.all() or (rests.any() and {"friction", "rotors"} & set(regression.what)):
        arm, pairs = regression.arm, ((getattr(run.reference, "q", run.q), run.q) for run in runs)
        planned, moved = np.max([[np.ptp(q, axis=0) for q in pair] for pair in pairs], axis=0)
        why = "did not move beyond the noise of the positions; record a motion of taut.analysis.excitation(arm), or "
        why += "leave a part out of what"
        if (sticks := rests & (planned > STICKS * moved)).any():
            rests, spans = sticks, ", ".join(f"{planned[i]:.3g} {arm.units[i]}" for i in np.flatnonzero(sticks))
            why = f"sticks while the reference moves by {spans}: the law gives less than dry friction holds; use a "
            why += "larger kp of this joint, or FrictionCompensation with a guess of its friction in the law's arm"
        names = [arm.joint_names[i] for i in np.flatnonzero(rests)]
        raise NumericalError(f"too little excitation: {quoted_list(names)} {why}", name="runs", joint=names[0])


def _uncertain(estimates: Mapping[str, Estimate]) -> tuple[str, ...]:
    """Parameters with a standard deviation above 20 % of their size, of a vector or matrix its largest entry."""
    groups = {name: re.sub(r"\.([hI])_\w+$", r".\1", name) for name in estimates}
    size = dict.fromkeys(groups.values(), 0.0)
    for name, group in groups.items():
        size[group] = max(size[group], abs(estimates[name].value))
    return tuple(name for name, each in estimates.items() if each.std > UNCERTAIN * size[groups[name]])


def _rms(x: Float64Array) -> Float64Array:
    return np.asarray(np.sqrt(np.nanmean(x**2, axis=0)))


def _figure(found: Identification) -> Figure:
    """Measured torques, and those of the model before and after."""
    from matplotlib.figure import Figure

    n = found.arm.n
    figure = Figure(figsize=(WIDTH, 1.0 + n), layout="constrained")
    t = np.where(np.diff(found.t, append=np.inf) > 0.0, found.t, np.nan)  # no line from one run to the next
    for i, ax in enumerate(axes := np.atleast_1d(figure.subplots(n, 1, sharex=True))):
        unit = "torque [N m]" if found.arm.units[i] == "rad" else "force [N]"
        prepared(ax, found.arm.joint_names[i], unit, "time [s]" if i == n - 1 else "")
        ax.plot(t, found.measured[:, i], color=colour(7), linewidth=3.0, alpha=0.5, label="measured")
        ax.plot(t, found.before[:, i], color=colour(1), linewidth=1.0, linestyle=DASHED, label="model before")
        ax.plot(t, found.after[:, i], color=colour(0), linewidth=1.0, label="identified model")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=SMALL, frameon=False)
    return figure
