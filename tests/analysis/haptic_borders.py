"""The haptic display of figure 10.17: one slide and a virtual wall, its stability limit by theory and by bisection over runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from passive_things import Hand, Thing, radius, worst_thing

import taut
from taut.base.types import Float64Array

MASS, DAMPING, RATE = 0.2, 1.0, 1000.0  # [kg], [N s/m] of the display's slide, [Hz]
PUSH = 2.0  # [N] into the wall
KICK = 1e-6  # [m/s], far below what leaves the wall
NOTHING = Thing()
Values = Mapping[str, Any]


class VirtualWall(taut.Law):
    """A spring and a damper beyond the face of a wall, which pushes and does not pull.

    Law:          tau = -(K d + B v) where d = q - face > 0 and this is a push, else 0
    Closed loop:  m a + (b + B) v + K d = F_ext in the wall, as far as the period and the delay let it
    """

    K: taut.Gain  # [N/m]
    B: taut.Gain = taut.Gain(0.0)  # [N s/m]
    face: taut.Gain = taut.Gain(0.0)  # [m]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        d = x.q - self.face @ np.ones(1)
        push = self.K @ d + self.B @ x.v
        return taut.Torque(wall=-taut.math.where((d > 0.0) * (push > 0.0), push, 0.0))


class Touch(taut.environments.Environment):
    """A passive thing of masses and springs that the tip holds, and a damper to the ground.

    The masses start where the tip starts. Speeds first, then positions: no energy is made in many short steps.
    """

    thing: Thing = NOTHING
    b: float = 0.0  # [N s/m]

    def start(self, T_WE: taut.Pose) -> dict[str, Any]:
        n = len(self.thing.k)
        return {"home": T_WE.p[2], "z": taut.math.zeros(n), "w": taut.math.zeros(n)}

    def wrench(
        self, T_WE: taut.Pose, twist: Float64Array, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Any, dict[str, Any]]:
        x, k, mu = T_WE.p[2] - memory["home"], np.array(self.thing.k), np.array(self.thing.mu)
        force = -self.thing.k0 * x - self.b * twist[2]
        z, w = memory["z"], memory["w"]
        if len(k):
            stretch = k * (z - x)
            force = force + sum(stretch)
            w = w - dt * stretch / mu
            z = z + dt * w
        return taut.math.array([0.0, 0.0, force, 0.0, 0.0, 0.0]), {"home": memory["home"], "z": z, "w": w}


def slide(mass: float = MASS, damping: float = DAMPING, push: float = PUSH) -> taut.Arm:
    """One joint along z, pushed along it: drives hold its weight until the first force arrives, so no delay kicks it."""
    arm = taut.load_arm("gantry3").subset(["z"]).with_body("z", mass=mass).with_joints(viscous=damping)
    return arm.with_gravity([0.0, 0.0, push / mass])


@dataclass(frozen=True, kw_only=True)
class Display:
    """One of the displays of which the stiffness is searched."""

    mass: float = MASS
    damping: float = DAMPING
    B: float = 0.0
    rate: float = RATE
    taps: int = 0
    velocity: str = "measured"  # or difference
    cutoff: float | None = None  # [Hz]

    @property
    def velocities(self) -> Any:
        if self.cutoff is None:
            return self.velocity
        return (
            taut.sensors.LowPass(cutoff=self.cutoff)
            if self.velocity == "measured"
            else taut.sensors.Difference(cutoff=self.cutoff)
        )

    @property
    def wall(self) -> taut.analysis.StiffnessCheck:
        return taut.analysis.check_virtual_wall(
            mass=self.mass, damping=self.damping, B=self.B, rate=self.rate, delay=self.taps / self.rate,
            velocity=self.velocities,
        )  # fmt: skip

    @property
    def limit(self) -> float:
        """Maximum stable stiffness [N/m]."""
        return self.wall.limit

    def plant(self, thing: Thing = NOTHING, **options: Any) -> taut.RigidPlant:
        options = {"integrator": "rk4", **options}
        return taut.RigidPlant(
            slide(self.mass + thing.m0, self.damping),
            environment=None if thing == NOTHING else Touch(thing=thing),
            actuation=taut.drives.Actuation(delay=self.taps / self.rate),
            **options,
        )


@cache
def controller(rate: float, velocity: str, cutoff: float | None) -> taut.Controller:
    sensing = taut.Sensing(velocity=Display(velocity=velocity, cutoff=cutoff).velocities)
    return taut.compile(VirtualWall(K=1.0), slide(), rate=rate, sensing=sensing)


def pressed(display: Display, K: float, duration: float, plant: taut.RigidPlant | None = None) -> taut.Run:
    """A run in the wall, at the depth where it carries the push, after a kick."""
    ctrl = controller(display.rate, display.velocity, display.cutoff)
    ctrl.parameters["law.K"], ctrl.parameters["law.B"] = K, display.B
    return taut.run(
        ctrl, plant or display.plant(), taut.JointMotion(q=[0.0]), duration=duration, q0=[PUSH / K], v0=[KICK]
    )


def grows(run: taut.Run) -> bool:
    """Whether what a kick set off is larger at the end of a run than in its middle, or has left the wall."""
    if not run.outcome.ok or run.q[-len(run) // 5 :, 0].min() < 0.0:
        return True
    parts = np.array_split(run.v[:, 0], 5)
    middle, end = (float(np.average(part**2, weights=np.hanning(len(part)))) for part in (parts[2], parts[4]))
    return end > max(middle, 1e-24)  # what is left below that is rounding


def border(grows_at: Callable[[float], bool], guess: float, steps: int = 9, width: float = 0.06) -> float:
    """By bisection, between 6 % below and above a guess, so that it must be there at all."""
    low, high = (1.0 - width) * guess, (1.0 + width) * guess
    assert not grows_at(low)
    assert grows_at(high)
    for _ in range(steps):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows_at(middle) else (middle, high)
    return 0.5 * (low + high)


def simulated(display: Display) -> float:
    """The stiffest wall that holds, by runs long enough to tell growth from decay."""
    plant, guess = display.plant(), display.limit
    swing = 2.0 * np.pi * np.sqrt(display.mass / guess)
    duration = max(1000.0 / display.rate, 12.0 * display.mass / (display.damping + display.B), 60.0 * swing)
    return border(lambda K: grows(pressed(display, K, duration, plant)), guess)


def displays(seed: int, count: int) -> list[Display]:
    """Seeded displays, light and heavy, over what the issue names."""
    rng = np.random.default_rng(seed)
    made = []
    while len(made) < count:
        rate = float(rng.choice([250.0, 500.0, 1000.0, 2000.0]))
        mass, damping = 10.0 ** rng.uniform(-1.0, 0.5), 10.0 ** rng.uniform(-0.5, 0.8)
        display = Display(
            mass=mass, damping=damping, rate=rate,
            B=float(rng.choice([0.0, rng.uniform(0.0, 0.5) * mass * rate])),
            taps=int(rng.choice([0, 0, 1, 2, 5])),
            velocity=str(rng.choice(["measured", "difference"])),
            cutoff=float(rng.choice([30.0, 60.0])) if rng.uniform() < 0.4 else None,
        )  # fmt: skip
        if display.limit > 0.0:
            made.append(display)
    return made


# -------------------------------------------------------------------- with a passive thing in the hand

SUBSTEPS = 100  # in which resonances of some kHz keep their frequency


def borders_with_the_worst(hand: Hand, limit: float) -> tuple[float, float]:
    """The border with a worst thing by eigenvalues, and by runs of taut.

    The thing has few and broad resonances, so that a run of some seconds shows its growth; for a spring alone every
    frequency is the worst one, and a mass will do.
    """
    worst = worst_thing(dataclasses.replace(hand, K=1.05 * limit), pairs=1, heavy=10.0)
    thing = worst if hand.B or hand.delay else Thing(m0=5.0 * hand.m)
    predicted = border(lambda K: radius(dataclasses.replace(hand, K=K), thing) > 1.0, 1.03 * limit, steps=20)
    display = Display(
        mass=hand.m, damping=hand.b, B=hand.B, rate=hand.rate, taps=round(hand.delay * hand.rate),
        velocity="difference" if hand.differenced else "measured", cutoff=hand.cutoff,
    )  # fmt: skip
    plant = display.plant(thing, integrator="semi-implicit-euler", substeps=SUBSTEPS)
    return predicted, border(lambda K: grows(pressed(display, K, 4.0, plant)), predicted, steps=7)


# -------------------------------------------------------------------- encoder steps

STEP = 1e-4  # [m] of the encoder
FRICTIONS = (0.0, 0.25, 0.5, 0.9, 1.1, 1.5, 2.0)  # in K STEP / 2
STEP_STIFFNESSES = (500.0, 1000.0, 1800.0)  # [N/m], all below 2 b / T = 2000


def hunting(K: float, ratio: float) -> float:
    """[m] that a pressed spring swings, peak to peak, in the last second of ten, by the Coulomb friction it has."""
    arm = slide(push=0.0).with_friction(taut.Friction(viscous=DAMPING, coulomb=0.5 * ratio * K * STEP))
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(resolution=STEP))
    plant = taut.RigidPlant(arm, sensors=sensors, substeps=50)
    ctrl = spring()
    ctrl.parameters["law.kp"] = K
    run = taut.run(ctrl, plant, taut.JointMotion(q=[0.37 * STEP]), duration=10.0, q0=[5.3 * STEP])
    return float(np.ptp(run.q[-round(RATE) :, 0]))


@cache
def spring() -> taut.Controller:
    return taut.compile(taut.laws.PID(kp=1.0), slide(push=0.0), rate=RATE)
