"""Episodes: a scenario as a learning problem, many arms side by side; what the Gymnasium environments are made of."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from taut.analysis.comparison import Experiment
from taut.arm.description import Arm
from taut.base.checks import float_array, instance_of, whole_number
from taut.base.errors import ShapeError, UsageError, unknown_name
from taut.base.fields import Choice, Declared, Field, Plain, Whole
from taut.base.paths import subtree
from taut.base.types import Array, Float64Array
from taut.codegen.functions import DOUBLE
from taut.codegen.lanes.loop import LANE_TICKS
from taut.codegen.lanes.rows import LANE_FRESH, TIME, RowArrays, RowCode
from taut.codegen.llvm import Lanes
from taut.codegen.native import cores, host_lanes
from taut.codegen.program import Block, Values, trace
from taut.control.command import Command, Torque
from taut.control.law import Law
from taut.control.laws.impedance import Impedance
from taut.control.laws.joint import ComputedTorque
from taut.control.tasks.feed import ReferenceFeed
from taut.control.tasks.task import Task
from taut.control.trajectories.reference import JointMotion, Sample, Shapes, Stream
from taut.control.trajectories.task_reference import TaskMotion
from taut.controller import Controller
from taut.loop import DT, Loop, ModelPlant, state_at_start
from taut.maths.model import model_of
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import exp_rows, rotation_log
from taut.runtime.host import PlantBase
from taut.scenarios.scenario import load_scenario

Mask = NDArray[np.bool_]
Action = Literal["joint change", "torque", "pose", "pose change"]
SCALES: Final[Mapping[str, tuple[float, ...]]] = {
    "joint change": (0.02,),  # [rad | m]
    "pose": (0.2, 0.2, 0.2, 0.5, 0.5, 0.5),  # [m], [rad]
    "pose change": (0.01, 0.01, 0.01, 0.05, 0.05, 0.05),
}
"""Meaning of an action of 1 where none is stated; a torque is the limit of its joint."""


class JointTorque(Sample):
    """Desired torques (n,) of the joints: what an action gives."""

    __slots__ = ("tau",)
    _shapes: ClassVar[Shapes] = {"tau": ("n",)}
    tau: Array

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> JointTorque:  # noqa: ARG003
        return cls.of({"tau": x.g})


class GivenTorque(Law):
    """The torque of an action.

    Law:  tau = tau_des
    """

    reference = JointTorque

    def command(self, x: Snapshot, ref: JointTorque) -> Command:  # noqa: ARG002
        return Torque(action=ref.tau)


class Episode(Declared):
    """A scenario as a learning problem: actions take the place of its reference, which is still to be followed.

    Action:       numbers, cut to -1 ... 1, which act for `decimation` ticks
                  "joint change": q_des += scale action, within the limits of the joints
                  "torque": tau = scale action, without a law
                  "pose": p_des = p_0 + scale action, R_des = exp(scale action) R_0, from the tool's pose at the start
                  "pose change": the same, from the desired pose before
                  `gains`: further numbers are parameters, from one end to the other on a logarithmic scale
    Observation:  q, v, and the error of the scenario's reference with its rate: of the joints, or of the tool
                  (position, then rotation vector; world axes). Where the scenario has phases, a source or forces in
                  place of a motion that is known beforehand, it is of the joints, from the motion that its first law
                  makes in a run
    Reward:       1 / (1 + (|error| / width)^2) - effort mean over the ticks of sum((tau / limit)^2)
    End:          truncated after the scenario's duration; terminated, with reward 0, where a number is not finite,
                  and info["reason"] says which

    Args:
        scenario: Name or file of a scenario. Its events are left out of the episodes.
        action: Kind of action.
        law: Label of the law that follows the action. If left out it is the first of the scenario that can, else
            ComputedTorque(kp=400, kd=40) for joints, Impedance(K=(800, 40), zeta=1) for poses.
        case: Case of the scenario; the first one if left out.
        values: Keys of the file that are replaced: {"plant.kind": "rigid"}.
        decimation: Ticks of an action.
        scale: Meaning of 1, for all numbers of the action or for each.
        gains: Ends (low, high) of parameters of law or plant by path: {"law.K": (100.0, 1000.0)}.
        width: Error at which half the reward is left [rad | m].
        effort: Weight of the torques; joints without a limit do not count.
    """

    scenario: Plain[str] = Plain(str)
    action: Choice[Action] = Choice("joint change", "torque", "pose", "pose change")
    law: Plain[str | None] = Plain(str, optional=True)
    case: Plain[str | None] = Plain(str, optional=True)
    values: Plain[Mapping[str, Any]] = Plain(Mapping, default={})  # type: ignore[type-abstract]
    decimation: Whole = Whole(10, minimum=1)
    scale: Field = Field(shape="numbers", accepts=("scalar",), above=0.0, optional=True, run_time=False)
    gains: Plain[Mapping[str, Any]] = Plain(Mapping, default={})  # type: ignore[type-abstract]
    width: Field = Field(0.1, unit="rad | m", above=0.0, run_time=False)
    effort: Field = Field(0.01, minimum=0.0, run_time=False)


class FusedArms:
    """n loops of a controller and a model plant under references from outside, in lanes."""

    def __init__(self, ctrl: Controller, plant: ModelPlant, n: int, duration: float, limits: Float64Array) -> None:
        loop, joints = Loop(ctrl, plant, duration=duration), plant.arm.n
        inputs = Block.of({**loop.input_shapes(), "start.q": (joints,), "start.v": (joints,)})
        parameters, numbers = Block.of(loop.parameter_shapes()), {**loop.parameters, DT: np.asarray(loop.dt)}
        with np.errstate(all="ignore"):  # of which only the shapes count
            begun = loop.start(plant.arm.home, np.zeros(joints), inputs.views(inputs.zeros()), numbers)
        memory = Block.of({path: np.shape(value) for path, value in begun.items()})

        def tick(given: Values, numbers: Values, before: Values) -> tuple[Values, Values]:
            record, after = loop.step(given, numbers, before)
            used = record["tau"] / limits
            return {"effort": used @ used}, after

        def begin(given: Values, numbers: Values, _: Values) -> tuple[Values, Values]:
            return loop.start(given["start.q"], given["start.v"], given, numbers), {}

        repeats = plant.substeps - 1
        code = RowCode(
            trace(tick, inputs, parameters, memory), Lanes(host_lanes(DOUBLE)),
            start=trace(begin, inputs, parameters, Block()),
            substep=(trace(loop.substep, inputs, parameters, memory), repeats) if repeats else None,
        )  # fmt: skip
        self._arrays, self._threads = RowArrays(code, n), cores()
        rows, self._used = np.zeros((n, code.memory.size)), np.zeros(n)
        self._memory = code.memory.views(rows)
        self._given = {path: np.zeros((n, *shape)) for path, shape in inputs.shapes.items() if path != TIME}
        for path, array in {**self._given, "memory": rows, "effort": self._used}.items():
            self._arrays.put(path, array)
        for path, value in numbers.items():
            self._arrays.put(path, value, per_lane=False)
        self.q, self.v = self._memory["plant.q"], self._memory["plant.v"]
        self.alive, self.effort = np.ones(n, dtype=np.bool_), np.zeros(n)

    def begin(self, lanes: Mask, q: Float64Array, v: Float64Array, rng: np.random.Generator) -> None:  # noqa: ARG002
        """Some lanes begin a run in the state q, v."""
        for array, value in ((self.q, q), (self.v, v), (self._given["start.q"], q), (self._given["start.v"], v)):
            array[lanes] = value
        self._memory[LANE_FRESH][lanes], self._memory[LANE_TICKS][lanes] = 1.0, 0.0
        self.alive |= lanes

    def put(self, path: str, values: Float64Array) -> None:
        """New values (n, ...) of a parameter."""
        self._arrays.put(path, values)

    def advance(self, ref: Mapping[str, Float64Array], ticks: int, rng: np.random.Generator) -> None:
        """Some ticks under references (n, ...) by field; `effort` is the mean over them of sum((tau / limit)^2)."""
        self.effort[:] = 0.0
        for name, value in ref.items():
            self._given[f"ref.{name}"][...] = value
        for _ in range(ticks):
            for path, array in self._given.items():
                if path.startswith("noise."):
                    rng.standard_normal(out=array)
            self._arrays.run(self._threads)
            self.alive &= self._arrays.finite
            self.effort += self._used / ticks


class HostedArms:
    """The same with plants that have a state of their own, each stepped in Python."""

    def __init__(self, ctrl: Controller, plant: PlantBase, n: int, limits: Float64Array) -> None:
        self._plants = [plant, *(plant.like() for _ in range(n - 1))]
        if None in self._plants:
            raise UsageError(f"plant '{plant.name}' makes no other of its kind; take one arm", name="n")
        self._batch, self._limits, self._takes = ctrl.batch(n), limits, ("q", *ctrl.side.takes)
        self.q, self.v = np.zeros((n, plant.arm.n)), np.zeros((n, plant.arm.n))
        self.alive, self.effort = np.ones(n, dtype=np.bool_), np.zeros(n)

    def begin(self, lanes: Mask, q: Float64Array, v: Float64Array, rng: np.random.Generator) -> None:
        self.q[lanes], self.v[lanes] = q, v
        self._batch.reset(lanes)
        self.alive |= lanes
        for i in np.flatnonzero(lanes):
            self._plants[i].reset(q.copy(), v.copy(), self._batch.side.dt, int(rng.integers(2**32)))

    def put(self, path: str, values: Float64Array) -> None:
        if path in self._batch.parameters:
            self._batch.parameters[path] = values
        for plant, value in zip(self._plants, values, strict=True) if path in self._plants[0].parameters else ():
            plant.set_parameters({path: value})

    def advance(self, ref: Mapping[str, Float64Array], ticks: int, rng: np.random.Generator) -> None:  # noqa: ARG002
        self.effort[:] = 0.0
        for _ in range(ticks):
            measured = [plant.measure() for plant in self._plants]
            commands = self._batch.step(
                ref=ref, **{name: np.array([one[name] for one in measured]) for name in self._takes}
            )
            self.alive &= self._batch.finite
            for i in np.flatnonzero(self.alive):
                tau = self._plants[i].advance(commands[i])
                self.effort[i] += np.sum((tau / self._limits) ** 2) / ticks
                self.alive[i] = self._plants[i].trouble() is None
        for i in np.flatnonzero(self.alive):
            self.q[i], self.v[i] = self._plants[i].state()


class Look:
    """What is seen of n arms and of the reference, in lanes."""

    def __init__(self, arm: Arm, kind: type[Sample], tool: str | None, n: int) -> None:
        model = model_of(arm)

        def look(given: Values, *_: Values) -> tuple[Values, Values]:
            x = Snapshot(model, q=given["q"], v=given["v"])
            ref, T = kind.of(subtree(given, "ref")).motion, x.T(tool)
            if isinstance(ref, JointMotion):
                error, rate = x.difference(ref.q), ref.v - x.v
            else:
                assert isinstance(ref, TaskMotion)
                error = np.concatenate([ref.p - T.p, rotation_log(ref.R @ T.R.T)])
                rate = ref.twist - x.J(tool) @ x.v
            return {"seen": np.concatenate([x.q, x.v, error, rate]), "error": error, "p": T.p, "R": T.R}, {}

        fields = {f"ref.{name}": shape for name, shape in kind.fields(arm.n).items()}
        program = trace(look, Block.of({"q": (arm.n,), "v": (arm.n,), **fields}), Block(), Block())
        self._arrays = RowArrays(RowCode(program, Lanes(host_lanes(DOUBLE))), n)
        made = {name: np.zeros((n, *shape)) for name, shape in program.outputs.shapes.items()}
        for name, array in made.items():
            self._arrays.put(name, array)
        self.seen, self.error, self.p, self.R = made["seen"], made["error"], made["p"], made["R"]

    def at(self, arms: FusedArms | HostedArms, ref: Mapping[str, Float64Array]) -> None:
        """Look at arms that are to be at references (n, ...) by field."""
        for path, array in {"q": arms.q, "v": arms.v, **{f"ref.{name}": rows for name, rows in ref.items()}}.items():
            self._arrays.put(path, array)
        self._arrays.run(cores())


class Episodes:
    """n episodes side by side."""

    def __init__(self, episode: Episode, n: int) -> None:
        instance_of("episode", episode, Episode, "a taut.gym.Episode")
        self._n, self._episode = whole_number("n", n, minimum=1), episode
        scenario = load_scenario(episode.scenario, values=episode.values)
        cases = scenario.cases or {"": scenario}
        if episode.case is not None and episode.case not in cases:
            raise unknown_name(f"scenario '{scenario.name}'", "case", episode.case, cases)
        place = cases[episode.case or next(iter(cases))]
        experiment, plant = place.experiment, place.experiment.plant
        law, joints = _law({k: one for k, one in place.laws.items() if isinstance(one, Law)}, episode), plant.arm.n
        self._q0, self._v0 = state_at_start(plant.arm, experiment.q0, experiment.v0)
        self.steps = max(1, math.ceil(round(experiment.duration * experiment.rate) / episode.decimation))
        kind, rows = _followed(experiment, next(iter(place.laws.values())), self.steps * episode.decimation + 1)
        self._reference = {name: row[:: episode.decimation] for name, row in rows.items()}
        self._look = Look(plant.arm, kind, law.controlled_frame, n)
        ctrl, self._arm, self._fields = experiment.controller(law), plant.arm, law.reference.fields(joints)
        usual: Any = plant.arm.effort if episode.action == "torque" else SCALES[episode.action]
        scale = np.asarray(usual if episode.scale is None else episode.scale)
        size = 6 if "p" in self._fields else joints
        if not np.isfinite(scale).all():
            raise UsageError(
                f"arm '{plant.arm.name}' has joints without a torque limit; give scale, the torque of an action of 1",
                name="scale",
            )
        if scale.shape not in ((), (1,), (size,)):
            raise ShapeError(f"scale must be a number or ({size},); got {scale.tolist()}", name="scale")
        self._scale, self._gains = np.broadcast_to(scale, (size,)), dict[str, tuple[Any, Any]]()
        for path, both in episode.gains.items():
            if path not in {**plant.parameters, **ctrl.parameters}:
                raise unknown_name("the loop", "parameter", path, {**plant.parameters, **ctrl.parameters})
            owner: Any = ctrl.side if path in ctrl.parameters else plant
            ends = [owner.checked_parameter(path, end) for end in both] if isinstance(both, (tuple, list)) else []
            if len(ends) != 2 or not all((end > 0.0).all() for end in ends):
                raise UsageError(f"gains of {path} must be two ends (low, high) > 0; got {both!r}", name="gains")
            self._gains[path] = ends[0], ends[1] / ends[0]
        self.action_size = size + sum(low.size for low, _ in self._gains.values())
        self.arms: FusedArms | HostedArms
        if isinstance(plant, ModelPlant):
            self.arms = FusedArms(ctrl, plant, n, experiment.duration, plant.arm.effort)
        else:
            self.arms = HostedArms(ctrl, plant, n, plant.arm.effort)
        for path, value in experiment.parameters.items():
            self.arms.put(path, np.repeat(np.asarray(value)[np.newaxis], n, axis=0))
        self._step, everywhere = np.zeros(n, dtype=np.int64), np.ones(n, dtype=np.bool_)
        self._first = {"q": self._q0}
        self.begin(everywhere, np.random.default_rng(0))
        self._first |= {"p": self._look.p[0].copy(), "R": self._look.R[0].copy()}
        self._target = {name: np.repeat(value[np.newaxis], n, axis=0) for name, value in self._first.items()}

    @property
    def seen(self) -> NDArray[np.float32]:
        """(n, k) observations; zeros of a lane whose numbers are not finite."""
        largest = float(np.finfo(np.float32).max)
        return np.nan_to_num(np.clip(self._look.seen, -largest, largest)).astype(np.float32)

    def begin(self, lanes: Mask, rng: np.random.Generator) -> None:
        """Some lanes begin an episode."""
        self.arms.begin(lanes, self._q0, self._v0, rng)
        self._step[lanes] = 0
        self._watch()
        for name, value in self._first.items() if "p" in self._first else ():
            self._target[name][lanes] = value

    def act(self, actions: Any, rng: np.random.Generator) -> tuple[Float64Array, Mask, Mask]:
        """A step of all lanes by actions (n, k): rewards, and which lanes are terminated and truncated."""
        given = np.clip(float_array("actions", actions, shape=(self._n, self.action_size)), -1.0, 1.0)
        self._no_number = ~np.isfinite(given).all(axis=1)
        change, rest = given[:, : self._scale.size] * self._scale, given[:, self._scale.size :]
        for path, (low, ratio) in self._gains.items():
            part, rest = rest[:, : low.size].reshape(-1, *low.shape), rest[:, low.size :]
            self.arms.put(path, low * ratio ** (0.5 + 0.5 * part))
        target, kind = self._target, self._episode.action
        if kind == "joint change":
            target["q"] = np.clip(target["q"] + change, self._arm.lower, self._arm.upper)
        elif kind != "torque":
            base = self._first if kind == "pose" else target
            target["p"], target["R"] = base["p"] + change[:, :3], exp_rows(change[:, 3:]) @ base["R"]
        values = {**target, "tau": change}
        ref = {name: values.get(name, np.zeros(shape)) for name, shape in self._fields.items()}
        self.arms.advance(ref, self._episode.decimation, rng)
        self._step = np.minimum(self._step + 1, self.steps)
        self._watch()
        far = np.sum(self._look.error**2, axis=1) / float(self._episode.width) ** 2
        reward = 1.0 / (1.0 + far) - float(self._episode.effort) * self.arms.effort
        return np.where(self.arms.alive, reward, 0.0), ~self.arms.alive, self._step >= self.steps

    def info(self, terminated: Mask) -> dict[str, Any]:
        """Why lanes are terminated, as a vector environment gives it."""
        why = np.where(self._no_number, "the action is not finite", "the simulation diverged")
        return {"reason": np.where(terminated, why, ""), "_reason": terminated} if terminated.any() else {}

    def _watch(self) -> None:
        self._look.at(self.arms, {name: rows[self._step] for name, rows in self._reference.items()})


def _followed(experiment: Experiment, law: Law | Task, ticks: int) -> tuple[type[Sample], dict[str, Float64Array]]:
    """What is to be followed, by field: a reference that is known beforehand, or the motion of the scenario's law."""
    ctrl = experiment.controller(law, engine="float")
    side, kind = ctrl.side, ctrl.side.law.reference
    moves = issubclass(getattr(kind, "kind", kind), (JointMotion, TaskMotion))
    if side.task is None and moves and not isinstance(experiment.reference, Stream):
        q0 = state_at_start(experiment.plant.arm, experiment.q0, experiment.v0)[0]
        feed = ReferenceFeed(experiment.reference, kind, side.arm, side.dt, side.at_rest(q0))
        rows, done = {name: np.zeros((ticks, *shape)) for name, shape in kind.fields(side.arm.n).items()}, 0
        while done < ticks:
            done += feed.fill({name: row[done:] for name, row in rows.items()}, done, lambda: None)
        return kind, rows
    prepared = experiment.prepared(law)
    run = prepared.run(prepared.controller(law))
    k = np.minimum(np.arange(ticks), len(run) - 1)
    v = np.where(np.arange(ticks)[:, np.newaxis] < len(run), run.v[k], 0.0)
    return JointMotion, {"q": run.q[k], "v": v, "a": 0.0 * v}


def _law(laws: Mapping[str, Law], episode: Episode) -> Law:
    """The law that follows an action."""
    if episode.action == "torque":
        return GivenTorque()
    joints = episode.action == "joint change"
    kind = JointMotion if joints else TaskMotion
    fitting = {label: law for label, law in laws.items() if issubclass(law.reference, kind)}
    if episode.law is not None and episode.law not in fitting:
        raise unknown_name(f"the scenario for the action '{episode.action}'", "law", episode.law, fitting)
    usual = ComputedTorque(kp=400.0, kd=40.0) if joints else Impedance(K=(800.0, 40.0), zeta=1.0)
    return fitting[episode.law] if episode.law is not None else next(iter(fitting.values()), usual)
