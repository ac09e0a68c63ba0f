"""Sensing: from measurements to what the law sees: filters, velocities, and the load of a wrist sensor.

Filters are made discrete by the bilinear transform, with coefficients from the parameters in every tick: they
remember inputs and outputs, so that a change of parameters moves nothing that stands still.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import entry_names
from taut.base.errors import RangeError, UsageError
from taut.base.fields import Choice, Declared, Field, Part, Plain
from taut.base.paths import subtree
from taut.base.types import Array, Wrench
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.trace import math as tm

if TYPE_CHECKING:
    from taut.control.observer import MomentumObserver
    from taut.maths.wrist import SensorPlace

Values = Mapping[str, Any]
Subtraction = Callable[[Array, Array], Array]
DECIBEL: Final = math.log(10.0) / 20.0  # natural logarithm of an amplitude per decibel
SATURATED: Final = "saturated.F_ext"  # 1.0 in a tick whose reading is at the end of the sensor's range
WRENCH: Final = "N, N m"
AT_END: Final = 1.0 - 1e-9  # of the range: turning a reading into the world and back rounds


class LowPass(Declared):
    """A Butterworth low-pass of first or second order. As a velocity it filters the measured one.

    Law:          order 1: H(s) = w / (s + w),  order 2: H(s) = w^2 / (s^2 + sqrt(2) w s + w^2),  w = 2 pi cutoff,
                  made discrete by the bilinear transform with prewarping: the sampled filter has the gain 1 at
                  standstill, 1/sqrt(2) (-3 dB) at the cut-off, exactly and at every rate, and 0 at half the rate
                  It starts at its first input, and delays slow signals by 1/w, the second order by sqrt(2)/w.

    Args:
        cutoff: Scalar, or one for each entry of what it filters [Hz]; below half the controller's rate.
        order: 1 or 2.

    Raises:
        RangeError: A cut-off of zero or below, or at half the rate or above.

    Example:
        >>> import taut
        >>> LowPass(cutoff=30.0).parameters()
        {'cutoff': array(30.)}

    References:
        Oppenheim and Schafer, Discrete-time signal processing (2010), section 7.2. Chapter, section 10.1.
    """

    cutoff: Field = Field(unit="Hz", shape="n", above=0.0, hint="leave the filter out for none")
    order: Choice[Literal[1, 2]] = Choice(1, 2)

    def start(self, u: Array) -> dict[str, Any]:
        return {"u": u, "y": u} if self.order == 1 else {"u": u, "y": u, "u_prev": u, "y_prev": u}

    def filtered(
        self,
        u: Array,
        memory: Values,
        parameters: Values,
        dt: Any,
        difference: Subtraction = operator.sub,  # noqa: ARG002
    ) -> tuple[Array, dict[str, Any]]:
        k = tm.tan(math.pi * dt * parameters["cutoff"])
        u1, y1 = memory["u"], memory["y"]
        if self.order == 1:
            y = y1 + (k / (1.0 + k)) * ((u - y1) + (u1 - y1))
            return y, {"u": u, "y": y}
        u2, y2 = memory["u_prev"], memory["y_prev"]
        k2, root = k * k, math.sqrt(2.0) * k
        drive = k2 * ((u - y1) + 2.0 * (u1 - y1) + (u2 - y1))
        y = y1 + (drive + (1.0 - root + k2) * (y1 - y2)) / (1.0 + root + k2)
        return y, {"u": u, "y": y, "u_prev": u1, "y_prev": y1}


class Notch(Declared):
    """A notch in positions and velocities: it takes out a vibration, such as that of an elastic joint.

    Law:          H(s) = (s^2 + g b s + w^2) / (s^2 + b s + w^2),  w = 2 pi frequency, b = 2 pi width,
                  g = 10^(-depth / 20), made discrete so that the sampled filter has the gain g at the frequency, 1 at
                  standstill and at half the rate, and the width exactly; it starts without a transient

    It acts on q and v alike, on continuous joints the short way round.

    Args:
        frequency: Scalar or one per joint [Hz], below half the controller's rate; 0 for joints without a notch.
        width: Scalar or one per joint [Hz]: between the -3 dB frequencies of a notch of infinite depth.
        depth: Scalar or one per joint [dB], the attenuation at the frequency.

    Raises:
        RangeError: A number <= 0, or a frequency at half the rate or above.

    References:
        Orfanidis, Introduction to signal processing (1996), section 11.3.
    """

    frequency: Field = Field(unit="Hz", shape="n", above=0.0, zero_for_none=True, hint="leave the notch out for none")
    width: Field = Field(unit="Hz", shape="n", above=0.0, hint="leave the notch out for none")
    depth: Field = Field(40.0, unit="dB", shape="n", above=0.0, hint="leave the notch out for none")

    def start(self, u: Array) -> dict[str, Any]:
        rest = tm.zeros(len(u))
        return {"u": u, "du": rest, "y": rest, "y_prev": rest}

    def filtered(
        self, u: Array, memory: Values, parameters: Values, dt: Any, difference: Subtraction = operator.sub
    ) -> tuple[Array, dict[str, Any]]:
        # u less (1 - g) of the band around the frequency
        frequency, some = parameters["frequency"], True
        if np.ndim(frequency):
            some = frequency > 0.0
            frequency = tm.where(some, frequency, 0.25 / dt)
        beta = tm.tan(math.pi * dt * parameters["width"])
        narrow = 1.0 / (1.0 + beta)
        du = difference(u, memory["u"])
        y = (1.0 - narrow) * (du + memory["du"])
        y = y + 2.0 * narrow * tm.cos(2.0 * math.pi * dt * frequency) * memory["y"]
        y = y - (2.0 * narrow - 1.0) * memory["y_prev"]
        out = u - (1.0 - tm.exp(-DECIBEL * parameters["depth"])) * y
        if some is not True:
            out = tm.where(some, out, u)
        return out, {"u": u, "du": du, "y": y, "y_prev": memory["y"]}


class Difference(Declared):
    """Differences of positions of successive ticks, through a low-pass that takes the jitter of their steps.

    Law:          v = (q - q_prev) / dt, with q_prev the first position in the first tick, then `LowPass`
                  The short way round for continuous joints. Differencing delays by half a period; one step of an
                  encoder in one tick is a velocity of resolution / dt.

    Args:
        cutoff: Scalar or one per joint [Hz] of the low-pass, below half the controller's rate; None for none.
        order: 1 or 2.

    Raises:
        RangeError: A cut-off <= 0, or at half the rate or above.

    References:
        Chapter, section 10.1 control system overview, and the pseudocode of figures 10.8 and 10.13.
    """

    cutoff: Field = Field(unit="Hz", shape="n", above=0.0, optional=True, hint="leave it out for no low-pass")
    order: Choice[Literal[1, 2]] = Choice(1, 2)

    def check(self) -> None:
        if self.cutoff is None and self.order != 1:
            self.refuse("order", "is that of the low-pass; give cutoff too")

    def start(self, u: Array) -> dict[str, Any]:
        rest = self._low_pass
        return {"q": u} if rest is None else {"q": u, **rest.start(tm.zeros(len(u)))}

    def filtered(
        self, u: Array, memory: Values, parameters: Values, dt: Any, difference: Subtraction
    ) -> tuple[Array, dict[str, Any]]:
        rate, low_pass = difference(u, memory["q"]) / dt, self._low_pass
        smooth, after = (rate, {}) if low_pass is None else low_pass.filtered(rate, memory, parameters, dt)
        return smooth, {"q": u, **after}

    @property
    def _low_pass(self) -> LowPass | None:
        return None if self.cutoff is None else LowPass(cutoff=self.cutoff, order=self.order)


class Kalman(Declared):
    """A steady Kalman filter of each joint's position and velocity, from measured positions alone.

    Law:          prediction  q- = q_hat + v_hat dt,  v- = v_hat
                  correction  q_hat = q- + alpha (q - q-),  v_hat = v- + (beta / dt) (q - q-);  the law sees v_hat
                  with the steady gains of the model  dv = a dt,  a white of density acceleration_noise^2,
                  measured with white noise of standard deviation position_noise:
                  lam = acceleration_noise dt^(3/2) / position_noise,  w = (lam + sqrt(lam^2/3 + 16)) / 2,
                  y = 2 / (w + sqrt(w^2 - 4)),  alpha = 1 - y^2,  beta = lam y

    The model knows neither the arm's dynamics nor the torque: constant acceleration leaves an error of velocity,
    constant velocity none. It starts at the first position, at rest. Its parameters may change at any tick.

    Args:
        acceleration_noise: Scalar or one per joint: square root of the acceleration's spectral density
            [rad/s^2/sqrt(Hz) | m/s^2/sqrt(Hz)]; more follows faster.
        position_noise: Scalar or one per joint: standard deviation of a measured position [rad | m], resolution /
            sqrt(12) of an encoder; more smooths more.

    Raises:
        RangeError: A number <= 0.

    Example:
        >>> alpha, beta = kalman_gains(1.0, 1.0, 1.0)
        >>> round(float(alpha), 4), round(float(beta), 4)
        (0.7567, 0.4932)

    References:
        Bar-Shalom, Li and Kirubarajan, Estimation with applications to tracking and navigation (2001), section 6.5;
        the root in closed form is ours. Kalata, The tracking index (1984), for the name.
    """

    acceleration_noise: Field = Field(unit="rad/s^2/sqrt(Hz) | m/s^2/sqrt(Hz)", shape="n", above=0.0)
    position_noise: Field = Field(
        unit="rad | m", shape="n", above=0.0, hint="for exact positions take the velocity 'difference'"
    )

    def start(self, u: Array) -> dict[str, Any]:
        return {"q_hat": u, "v_hat": tm.zeros(len(u))}

    def filtered(
        self, u: Array, memory: Values, parameters: Values, dt: Any, difference: Subtraction
    ) -> tuple[Array, dict[str, Any]]:
        alpha, beta = kalman_gains(parameters["acceleration_noise"], parameters["position_noise"], dt)
        predicted = memory["q_hat"] + memory["v_hat"] * dt
        surprise = difference(u, predicted)
        v_hat = memory["v_hat"] + (beta / dt) * surprise
        return v_hat, {"q_hat": predicted + alpha * surprise, "v_hat": v_hat}


def kalman_gains(acceleration_noise: Any, position_noise: Any, dt: Any) -> tuple[Array, Array]:
    """Steady gains alpha and beta of a constant-velocity model with white acceleration, in closed form.

    With y = sqrt(1 - alpha) and beta = lam y, the steady Riccati equation is (1/y - y)^2 - lam (1/y + y) +
    lam^2 / 6 = 0, a quadratic in w = y + 1/y; its roots avoid cancellation. Source: Bar-Shalom, Li and Kirubarajan
    (2001), section 6.5.3: alpha = sqrt(2 beta + beta^2/12) - beta/2 and beta^2 = lam^2 (1 - alpha).
    """
    lam = acceleration_noise * dt * tm.sqrt(dt) / position_noise
    root = tm.sqrt(lam * lam / 3.0 + 16.0)
    above = 0.5 * (lam + (lam * lam / 3.0) / (root + 4.0))  # w - 2
    sum_ = above + 2.0 + tm.sqrt(above * (above + 4.0))  # w + sqrt(w^2 - 4) = 2 / y
    y = 2.0 / sum_
    return (1.0 - y) * (1.0 + y), lam * y


def check_filter(part: Declared, path: str, rate: float, joints: Sequence[str] | int) -> None:
    """A filter's numbers: a scalar or one for each of `joints`, below half the rate [Hz]. ShapeError, RangeError."""
    part.check_size(joints, f"{path}.")
    check_frequencies(part, path, rate, None if isinstance(joints, int) else joints)


def check_frequencies(part: Declared, path: str, rate: float, entries: Sequence[str] | None = None) -> None:
    """Every number in Hz is below half the rate."""
    for name, values in part.parameters().items():
        if part.units()[name] == "Hz" and np.any(values >= 0.5 * rate):
            index = [int(i) for i in np.argwhere(values >= 0.5 * rate)[0]]
            value = float(values[tuple(index)])
            raise RangeError(
                f"{entry_names(f'{path}.{name}', index, entries)} must be < {0.5 * rate:g} [Hz], half the "
                f"controller's rate of {rate:g} Hz; got {value!r}; make it lower, or the rate higher",
                name=f"{path}.{name}",
                joint=entries[index[0]] if entries is not None and index else None,
                value=value,
                rule="below half the rate",
            )


class Wrist(Declared):
    """What is known of a sensor between arm and tool, so that a law sees contact alone as `x.F_ext`.

    Law:          F_ext = reading - bias - weight of the tool - weight of the controller's payload
                  A weight is m g with the moment c x m g, turned by the measured positions. Inertia forces of a tool
                  that accelerates stay in; a low-pass, `Sensing(F_ext=taut.sensors.LowPass(...))`, comes after.

    Every number is a run-time parameter: sensing.wrist.bias, sensing.wrist.mass, ... The payload is that of the laws,
    model.payload.*, in the joints and in the sensor.

    Frames:
        bias, com and range are of the sensor's own axes and origin, those of `frame`, force first. Wrenches before
        and after are in world axes at the tool's origin.

    Args:
        bias: (6,) or (force, moment), the reading without load [N, N m].
        mass: [kg] of the tool beyond the sensor; None for readings that contain no weight, neither tool's nor
            payload's.
        com: (3,) centre of mass of that tool [m].
        range: (6,) or (force, moment) [N, N m], may be infinite. A reading at its end reaches the law as it is, and
            is reported in the run's column saturated.F_ext, its outcome and `ctrl.sensed`.
        frame: Frame of the sensor, on the tool's body; the tool's own if None.

    Raises:
        ShapeError: One number for forces and moments, a centre of mass that is no vector.
        RangeError: A negative mass, a range <= 0, NaN.
        UsageError: A centre of mass without a mass.

    Example:
        >>> wrist = Wrist(bias=[1.2, -0.4, 3, 0.02, 0, 0.01], mass=0.73, com=[0.0, 0.0, 0.06], range=(200.0, 10.0))
        >>> list(wrist.parameters())
        ['bias', 'mass', 'com', 'range']

    References:
        Kubus, Kroeger and Wahl, On-line rigid object recognition and pose estimation based on inertial parameters,
        IROS (2007): the load beyond a wrist sensor. Chapter, section 10.3 force control.
    """

    bias: Field = Field((0.0,) * 6, unit=WRENCH, shape=6, accepts=("pair",))
    mass: Field = Field(unit="kg", minimum=0.0, optional=True)
    com: Field = Field(unit="m", shape=3, optional=True)
    range: Field = Field(
        unit=WRENCH,
        shape=6,
        accepts=("pair",),
        above=0.0,
        infinite=True,
        optional=True,
        hint="leave it out for a sensor without end",
    )
    frame: str | None = None

    def check(self) -> None:
        if self.mass is None and self.com is not None:
            self.refuse("com", "is that of the tool, whose mass is missing; give mass too")
        if self.mass is not None and self.com is None:
            self.__dict__["com"] = np.zeros(3)

    def corrected(
        self, arm: Arm, q: Array, F_W: Wrench, parameters: Values, payload: PayloadValues
    ) -> tuple[Array, Any]:
        """Contact wrench (6,) of F_W, world axes at the tool's origin; 1.0 at the end of the range, None without."""
        from taut.maths.wrist import load_wrench

        R_WE, place, cut = dyn.pose(model_of(arm), q).R, self.place(arm), None
        if "range" in parameters:
            beyond = tm.abs(place.in_sensor(F_W, R_WE)) - AT_END * parameters["range"]
            cut = tm.where(functools.reduce(tm.maximum, beyond) >= 0.0, 1.0, 0.0)
        known = parameters["bias"]
        if "mass" in parameters:
            tool = PayloadValues(mass=parameters["mass"], com=parameters["com"], inertia=np.zeros(6)).body()
            load = tool + place.from_tool(payload.body())
            known = known + load_wrench(load, (R_WE @ place.R_ES).T @ arm.gravity)
        return F_W - place.in_world(known, R_WE), cut

    def place(self, arm: Arm) -> SensorPlace:
        """Pose of the sensor from the tool. Raises UnknownNameError; UsageError for a frame of another link."""
        from taut.maths.wrist import sensor_place

        return sensor_place(arm, self.frame, "sensing.wrist")


Filter: TypeAlias = LowPass | Notch | Difference | Kalman
"""Filter of one measurement u: `start(u)` is its memory as if u had always been constant, `filtered` its output."""
Velocity: TypeAlias = Literal["measured", "difference"] | LowPass | Difference | Kalman
WORDS: Final = ("measured", "difference")
SOURCES: Final = (LowPass, Difference, Kalman)


class Sensing(Declared):
    """What the law sees of the measurements.

    Positions and measured velocities go through the notch first; velocities are made from filtered positions.
    Every number is a run-time parameter: sensing.velocity.cutoff, sensing.notch.frequency, ...

    Args:
        velocity: "measured", or filtered by `taut.sensors.LowPass(cutoff=)`; "difference" of positions of successive
            ticks, or with a low-pass `taut.sensors.Difference(cutoff=)`; an estimate, `taut.sensors.Kalman(...)`.
        notch: Takes a vibration out of positions and velocities.
        wrist: Bias, load and range of the wrist sensor; the first two are taken out of the measured wrench.
        F_ext: Low-pass of the measured wrench, for a law that uses it; after `wrist`.
        tau_meas: Low-pass of the measured joint torques, for a law that uses them.
        observer: Estimates the joint torques of the environment, x.tau_ext; recorded in every run.

    Raises:
        UsageError: Anything else.

    Example:
        >>> sensing = Sensing(velocity=Difference(cutoff=30.0), notch=Notch(frequency=18.0, width=4.0))
        >>> list(sensing.parameters())
        ['velocity.cutoff', 'notch.frequency', 'notch.width', 'notch.depth']

    References:
        Chapter, section 10.1 control system overview, and the pseudocode of figures 10.8 and 10.13.
    """

    velocity: Plain[Velocity] = Plain(default="measured")
    notch: Part[Notch | None] = Part(Notch, optional=True)
    wrist: Part[Wrist | None] = Part(Wrist, optional=True)
    F_ext: Part[LowPass | None] = Part(LowPass, optional=True)
    tau_meas: Part[LowPass | None] = Part(LowPass, optional=True)
    observer: Plain[MomentumObserver | None] = Plain(default=None, optional=True)

    def check(self) -> None:
        known = self.velocity in WORDS if isinstance(self.velocity, str) else isinstance(self.velocity, SOURCES)
        if not known:
            words = ", ".join(map(repr, WORDS))
            self.refuse("velocity", f"must be {words}, a LowPass, Difference or Kalman; got {self.velocity!r}")
        if self.observer is not None:
            from taut.control.observer import MomentumObserver

            if not isinstance(self.observer, MomentumObserver):
                self.refuse("observer", f"must be a taut.sensors.MomentumObserver; got {self.observer!r}")
        if "F_ext" in self.estimates and (self.wrist is not None or self.F_ext is not None):
            given = "wrist" if self.wrist is not None else "F_ext"
            self.refuse(
                given, "is for a measured wrench, which the observer gives in its place; leave one of them out"
            )

    @property
    def estimates(self) -> tuple[str, ...]:
        """What the observer gives, by the name in the snapshot."""
        return () if self.observer is None else self.observer.estimates

    @property
    def needs_velocity(self) -> bool:
        """Whether a measured velocity is used."""
        return self.velocity == "measured" or isinstance(self.velocity, LowPass)

    def _filters(self) -> Iterator[tuple[str, Filter, str, str]]:
        """The path of each filter, the filter, the measurement that it takes, and the one that it gives."""
        if self.notch is not None:
            yield from ((f"notch.{name}", self.notch, name, name) for name in ("q", "v")[: 1 + self.needs_velocity])
        source = Difference() if self.velocity == "difference" else self.velocity
        if not isinstance(source, str):
            yield "velocity", source, "v" if self.needs_velocity else "q", "v"
        for name, low_pass in (("F_ext", self.F_ext), ("tau_meas", self.tau_meas)):
            if low_pass is not None:
                yield name, low_pass, name, name

    @property
    def tells(self) -> tuple[str, ...]:
        """Outputs beside the measurements: 1.0 in a tick in which a sensor is at the end of its range."""
        return (SATURATED,) if self.wrist is not None and self.wrist.range is not None else ()

    @property
    def alters(self) -> frozenset[str]:
        """Measurements that are changed before the law sees them."""
        own = {*self.estimates, *(["F_ext"] if self.wrist is not None else [])}
        return frozenset(name for *_, name in self._filters()) | own

    @property
    def summary(self) -> str:
        """Filters in use, in one line."""
        parts = [f"{name} by {type(part).__name__}" for _, part, _, name in self._filters()]
        parts += ["F_ext by Wrist"] if self.wrist is not None else []
        return ", ".join([*parts, *(f"{name} by MomentumObserver" for name in self.estimates)])

    def check_fit(self, arm: Arm, rate: float) -> None:
        """It must fit an arm and a rate [Hz]. Raises ShapeError, RangeError, UnknownNameError, UsageError."""
        for name, part in self.declared_parts().items():
            if isinstance(part, Wrist):
                part.place(arm)
            elif self.observer is not None and part is self.observer:
                self.observer.check_fit(arm, rate)
            else:
                check_filter(part, f"sensing.{name}", rate, 6 if name == "F_ext" else arm.joint_names)

    def check_used(self, used: Set[str], law: str) -> None:
        """Refuse parameters of measurements that the law does not use. Raises UsageError."""
        for field, name in (("wrist", "F_ext"), ("F_ext", "F_ext"), ("tau_meas", "tau_meas")):
            if name not in used and getattr(self, field) is not None:
                raise UsageError(
                    f"sensing changes {name}, which {law} does not use; leave {field} out of the sensing",
                    name=f"sensing.{field}",
                )

    def start(self, arm: Arm, measured: Values, parameters: Values, payload: PayloadValues) -> dict[str, Any]:
        """Memory by path at the first tick: as if the measurements had always been constant."""
        seen = {**measured, **self._wrench(arm, measured, parameters, payload)}
        return {
            f"{path}.{name}": value
            for path, part, source, _ in self._filters()
            for name, value in part.start(seen[source]).items()
        }

    def see(
        self, arm: Arm, measured: Values, memory: Values, parameters: Values, payload: PayloadValues, dt: Any
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """What the law sees, by measurement, and the new memory; with it what `tells` names.

        Memory is by path; parameters are by path below "sensing".
        """
        after: dict[str, Any] = {}
        seen = {**measured, **self._wrench(arm, measured, parameters, payload)}
        for path, part, source, name in self._filters():
            own, difference = subtree(parameters, path.partition(".")[0]), operator.sub
            if source == "q":
                difference = arm.difference
            seen[name], new = part.filtered(seen[source], subtree(memory, path), own, dt, difference)
            after |= {f"{path}.{entry}": value for entry, value in new.items()}
        return seen, after

    def _wrench(self, arm: Arm, measured: Values, parameters: Values, payload: PayloadValues) -> dict[str, Any]:
        """The measured wrench without what the wrist knows of it, and whether it is at the end of its range."""
        if self.wrist is None:
            return {}
        own = subtree(parameters, "wrist")
        F_ext, cut = self.wrist.corrected(arm, measured["q"], measured["F_ext"], own, payload)
        return {"F_ext": F_ext} if cut is None else {"F_ext": F_ext, SATURATED: cut}
