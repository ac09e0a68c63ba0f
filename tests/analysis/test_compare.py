"""Comparing and grading laws: each figure against a formula of its own, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from refusals import refused

import taut
from taut.base.errors import RangeError, ScenarioError, UnknownNameError, UsageError
from taut.scenarios.sections import law_of_text


class NoCoriolis(taut.Law):
    """Computed torque of a student who took g for h."""

    kp: taut.Gain  # [1/s^2]
    kd: taut.Gain  # [1/s]

    def command(self, x, ref):
        a = taut.Terms(feedforward=ref.a, P=self.kp @ x.difference(ref.q), D=self.kd @ (ref.v - x.v))
        return taut.Torque(x.M @ a + taut.Terms(nonlinear=x.g))


@pytest.fixture(scope="module")
def planar() -> taut.Loop:
    """Two joints that follow a sine, with a torque limit that cuts at times."""
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(taut.laws.PID(kp=100.0, kd=20.0), arm, limits=taut.Limits(tau=[40.0, 15.0]))
    ref = taut.trajectories.Sine(center=[0.3, 0.5], amplitude=[0.6, 0.5], frequency=[0.8, 1.1], phase=[0.0, 1.0])
    return taut.Loop(ctrl, taut.RigidPlant(arm), ref, duration=1.0)


@pytest.fixture(scope="module")
def table(planar: taut.Loop) -> taut.analysis.Comparison:
    laws = {
        "PD": "PID(kp=200, kd=20)",
        "exact": "ComputedTorque(kp=100, kd=20)",
        "no C": NoCoriolis(kp=100.0, kd=20.0),
    }
    return taut.compare(
        laws, planar, by="rms_error", model=taut.analysis.WrongModel(mass=0.3, payload=1.0, trials=3, seed=7)
    )


def test_the_figures_are_those_of_the_recorded_arrays(table: taut.analysis.Comparison) -> None:
    for entry in table.entries.values():
        run, numbers = entry.run, entry.numbers
        error = np.linalg.norm(run.reference.q - run.q, axis=1)
        cut = np.any(run.terms["torque_limit"][:-1] != 0.0, axis=1)
        steps = np.abs(np.diff(run.tau, axis=0)).sum()
        assert numbers["rms_error"]["rad"] == pytest.approx(math.sqrt(np.mean(error**2)), rel=1e-12)
        assert numbers["peak_error"]["rad"] == pytest.approx(error.max(), rel=1e-12)
        assert numbers["steady_error"]["rad"] == pytest.approx(math.sqrt(np.mean(error[800:] ** 2)), rel=1e-12)
        assert numbers["effort"]["(N m)^2 s"] == pytest.approx(1e-3 * np.sum(run.tau[:-1] ** 2), rel=1e-12)
        assert numbers["peak_torque"]["N m"] == pytest.approx(np.abs(run.tau).max(), rel=1e-12)
        assert numbers["saturation_time"]["s"] == pytest.approx(1e-3 * cut.sum(), rel=1e-9)
        assert numbers["chatter"]["N m/s"] == pytest.approx(steps / run.t[-1], rel=1e-12)
    assert table.entries["PD"].numbers["saturation_time"]["s"] > 0.01


def test_laws_are_ranked_by_the_figure_that_was_asked_for(table: taut.analysis.Comparison, planar: taut.Loop) -> None:
    errors = {name: entry.numbers["rms_error"]["rad"] for name, entry in table.entries.items()}
    assert list(table.ranking) == sorted(errors, key=lambda name: errors[name])
    two = taut.compare(list(table.runs.values()), by="effort")
    spent = [entry.numbers["effort"]["(N m)^2 s"] for entry in two.entries.values()]
    assert spent == sorted(spent)
    assert spent != [table.entries[name].numbers["effort"]["(N m)^2 s"] for name in table.ranking]


def test_wrong_models_are_the_arms_of_the_stated_seeds(table: taut.analysis.Comparison, planar: taut.Loop) -> None:
    believed, errors = planar.side.arm, []
    for seed in (7, 8, 9):
        more = float(np.random.default_rng([seed, 1]).random())
        load = believed.payload
        true = believed.perturbed(seed=seed, mass=0.3).with_payload(load.mass + more, load.com, load.inertia)
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), believed, limits=planar.side.limits)
        run = taut.run(ctrl, taut.RigidPlant(true), planar.ref, duration=1.0)
        errors.append(run.metrics.overall("rms_error"))
    numbers = table.entries["exact"].numbers
    assert numbers["model_median"]["rad"] == sorted(errors)[1]
    assert numbers["model_worst"]["rad"] == max(errors)
    assert "3 true arms, spread mass 30 %, payload 1 kg, seed 7" in str(table)


def test_noise_of_positions_makes_the_chatter_that_white_noise_makes() -> None:
    """E |w_k+1 - w_k| = 2 sigma / sqrt(pi) for normal w, times kp, rate times a second.

    Without noise the torque is constant, and where the arm is level gravity does not change with the angle.
    """
    arm = taut.load_arm("one_joint")
    ctrl = taut.compile(taut.laws.GravityPID(kp=2.0, kd=0.0), arm, rate=500.0)
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(noise=1e-4))
    loop = taut.Loop(
        ctrl, taut.RigidPlant(arm, friction=None, sensors=sensors), taut.JointMotion(q=[0.0]), duration=60.0
    )
    loop.parameters["law.kp"] = 3.0  # of the loop's own law, which is not compared
    told = taut.compare(["GravityPID(kp=2, kd=0.5)"], loop, model=None)
    found = next(iter(told.entries.values())).numbers["noise_chatter"]["N m/s"]
    assert found == pytest.approx(500.0 * 2.0 * 1e-4 * 2.0 / math.sqrt(math.pi), rel=0.02)


def test_noise_that_the_plant_has_is_compared_with_none() -> None:
    arm = taut.load_arm("one_joint")
    ctrl = taut.compile(taut.laws.PID(kp=2.0, kd=0.5), arm)
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(noise=1e-4, resolution=1e-5))
    plant = taut.RigidPlant(arm, sensors=sensors)
    loop = taut.Loop(ctrl, plant, taut.JointMotion(q=[0.0]), duration=0.5)
    told = taut.compare({"PD": taut.laws.PID(kp=2.0, kd=0.5)}, loop, model=None)
    runs = [
        taut.run(ctrl, p, loop.ref, duration=0.5)
        for p in (
            plant,
            taut.RigidPlant(arm, sensors=taut.sensors.Sensors(position=taut.sensors.Encoder(resolution=1e-5))),
        )
    ]
    more = runs[0].metrics.overall("chatter") - runs[1].metrics.overall("chatter")
    assert told.entries["PD"].numbers["noise_chatter"]["N m/s"] == more
    assert "the sensors as they are, against the same without noise" in str(told)


def test_changed_parameters_of_a_loop_hold_for_every_law(planar: taut.Loop) -> None:
    loop = taut.Loop(taut.compile(planar.side.law, planar.side.arm), planar.plant, planar.ref, duration=0.3)
    loop.parameters["plant.payload.mass"] = 2.0
    told = taut.compare({"same": planar.side.law}, loop, noise=False, model=None)
    assert np.array_equal(told.runs["same"].q, taut.run(loop).q)


def test_every_run_starts_where_it_is_told_to(planar: taut.Loop) -> None:
    told = taut.compare({"same": planar.side.law}, planar, noise=False, model=None, q0=[0.3, 0.1], v0=[0.2, 0.0])
    assert told.runs["same"].q[0].tolist() == [0.3, 0.1]
    graded = taut.analysis.grade("PID(kp=200)", "PID(kp=200, kd=1)", planar, q0=[0.3, 0.1], v0=[0.2, 0.0])
    assert [run.v[0].tolist() for run in runs_of(graded)] == [[0.2, 0.0]] * 2


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_law_that_fails_has_no_figures_and_comes_last(planar: taut.Loop) -> None:
    told = taut.compare(
        {"wild": "PID(kp=1e9, kd=1e7)", "PD": "PID(kp=200, kd=20)"}, without_limits(planar), by="effort", model=None
    )
    assert told.ranking == ("PD", "wild")
    assert not told.ok
    assert told.entries["wild"].numbers == {}
    assert "wild: the simulation diverged" in str(told)


def without_limits(loop: taut.Loop) -> taut.Loop:
    """The same without limits, which would save a wild law."""
    return taut.Loop(taut.compile(loop.side.law, loop.side.arm), loop.plant, loop.ref, duration=0.3)


def test_the_picture_has_errors_left_and_torques_right(table: taut.analysis.Comparison) -> None:
    axes = [ax for ax in table.plot().axes if ax.get_visible()]
    assert [ax.get_title(loc="left") for ax in axes[:2]] == ["norm of the tracking error", "norm of the torques"]
    error, torque = axes[0].get_lines()[0].get_ydata(), axes[1].get_lines()[0].get_ydata()
    first = table.runs[table.ranking[0]]
    assert np.allclose(error, np.linalg.norm(first.reference.q - first.q, axis=1))
    assert np.allclose(torque, np.linalg.norm(first.tau, axis=1))


# -------------------------------------------------------------------- grading


def runs_of(grade: taut.analysis.Grade) -> list[taut.Run]:
    """Of the law, and of the reference."""
    return list(grade.comparison.runs.values())


def test_a_wrong_term_is_found_with_its_joint_and_time(planar: taut.Loop) -> None:
    loop = without_limits(planar)
    told = taut.analysis.grade(NoCoriolis(kp=100.0, kd=20.0), "ComputedTorque(kp=100, kd=20)", loop, tolerance=0.01)
    run = runs_of(told)[1]
    states = [taut.snapshot(loop.side.arm, q, v) for q, v in zip(run.q, run.v, strict=True)]
    coriolis = np.array([np.asarray(x.h) - np.asarray(x.g) for x in states])
    k, i = np.unravel_index(np.argmax(np.abs(coriolis)), coriolis.shape)
    assert not told.ok
    assert told.wrong_term == "nonlinear"
    assert [one.what for one in told.terms] == ["nonlinear"]
    assert told.command.size == pytest.approx(abs(coriolis[k, i]), rel=1e-9)
    assert (told.command.t, told.command.joint) == (run.t[k], loop.side.arm.joint_names[i])


class Wrong(taut.Law):
    """Computed torque whose term D has the wrong sign.

    Law:          tau = M (a_des + kp e - kd e_dot) + h
    Closed loop:  e_ddot - kd e_dot + kp e = 0
    """

    kp: taut.Gain  # [1/s^2]
    kd: taut.Gain  # [1/s]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        a = taut.Terms(feedforward=ref.a, P=self.kp @ (ref.q - x.q), D=-(self.kd @ (ref.v - x.v)))
        return taut.Torque(x.M @ a + taut.Terms(nonlinear=x.h))


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_term_that_is_wrong_in_its_own_measure_is_told_where_the_command_hardly_shows_it() -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    way = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.5, duration=1.0)
    loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), way, duration=0.3)
    told = taut.analysis.grade(Wrong(kp=100.0, kd=20.0), "ComputedTorque(kp=100, kd=20)", loop)
    assert told.command.ok
    assert told.wrong_term == "D"
    assert [term.ok for term in told.terms] == [False]
    assert not told.ok


def test_what_depends_on_time_is_graded_at_its_time(planar: taut.Loop) -> None:
    """Two dithers of another frequency: A |sin a t - sin b t| is largest where the closed form says, not at t = 0."""
    laws = [f"PID(kp=200, kd=20) + Dither(amplitude=[2, 0], frequency=[{f}, 1])" for f in (4.0, 5.0)]
    grade = taut.analysis.grade(laws[0], laws[1], planar)
    t = np.arange(1001) * 1e-3
    gap = 2.0 * np.abs(np.sin(2.0 * np.pi * 4.0 * t) - np.sin(2.0 * np.pi * 5.0 * t))
    assert grade.wrong_term == "dither"
    assert grade.terms[0].size == pytest.approx(gap.max(), rel=1e-9)
    assert grade.terms[0].t == pytest.approx(t[np.argmax(gap)])


def test_laws_side_by_side_have_the_errors_of_the_worst() -> None:
    arm = taut.load_arm("gantry3")
    first, *rest = arm.joint_names
    gains = {"soft": 100.0, "stiff": 400.0}
    laws = {
        name: taut.SideBySide(
            one=(taut.laws.GravityPID(kp=kp, kd=20.0), [first]),
            others=(taut.laws.GravityPID(kp=400.0, kd=80.0), rest),
        )
        for name, kp in gains.items()
    }
    ref = taut.together(one=taut.JointMotion(q=arm.home[:1] + 0.1), others=taut.JointMotion(q=arm.home[1:] + 0.01))
    loop = taut.Loop(taut.compile(laws["soft"], arm), taut.RigidPlant(arm), ref, duration=0.5)
    told = taut.compare(laws, loop, by="rms_error", noise=False, model=None)
    assert told.ranking == ("stiff", "soft")
    for entry in told.entries.values():
        each = [math.sqrt(np.mean(np.sum(entry.run.part(p).error ** 2, axis=1))) for p in ("one", "others")]
        assert entry.numbers["rms_error"]["m"] == pytest.approx(max(each), rel=1e-12)
    told.plot()


def test_the_same_law_in_other_words_passes(planar: taut.Loop) -> None:
    told = taut.analysis.grade("FeedForward() + PID(kp=150, kd=15)", "PID(kp=150, kd=15) + FeedForward()", planar)
    assert told.ok
    assert told.command.size < 1e-9
    assert told.wrong_term is None


def test_a_figure_fails_to_either_side_of_the_tolerance(planar: taut.Loop) -> None:
    stiff, soft = "PID(kp=240, kd=20)", "PID(kp=200, kd=20)"
    better, worse = taut.analysis.grade(stiff, soft, planar), taut.analysis.grade(soft, stiff, planar)
    off = {mark.figure: mark.off for mark in better.marks}
    assert off["rms_error"] == pytest.approx(
        runs_of(better)[0].metrics.overall("rms_error") / runs_of(worse)[0].metrics.overall("rms_error") - 1.0,
        rel=1e-9,
    )
    assert off["rms_error"] < -0.05
    assert not better.ok
    assert not worse.ok
    assert taut.analysis.grade(stiff, soft, planar, tolerance=0.5).ok


def test_a_memory_runs_along_with_the_reference_states(planar: taut.Loop) -> None:
    told = taut.analysis.grade("PID(kp=200, kd=20, ki=50)", "PID(kp=200, kd=20, ki=100)", planar)
    run = runs_of(told)[1]
    e_int = np.cumsum(run.reference.q - run.q, axis=0) * 1e-3
    assert told.wrong_term == "I"
    assert told.terms[0].size == pytest.approx(50.0 * np.abs(e_int).max(), rel=1e-9)


# -------------------------------------------------------------------- texts


def test_a_text_makes_the_law_that_it_says() -> None:
    laws = taut.laws
    for text, law in {
        "PID(kp=100, kd=20)": laws.PID(kp=100.0, kd=20.0),
        "a: PID(kp=[1, 2])": laws.PID(kp=[1.0, 2.0]),
        "FeedForward() + PID(kp=3)": laws.FeedForward() + laws.PID(kp=3.0),
        "ViaJointSpace(inner=PID(kp=3), speed=2)": taut.via_joint_space(laws.PID(kp=3.0), speed=2.0),
        "Impedance(K=(800, 30), zeta=0.7, null=None)": laws.Impedance(K=(800.0, 30.0), zeta=0.7, null=None),
    }.items():
        assert repr(law_of_text(text)[1]) == repr(law)
    assert law_of_text("a: PID(kp=1)")[0] == "a"
    assert law_of_text(" PID(kp=1,  kd=2)")[0] == "PID(kp=1, kd=2)"


@pytest.mark.parametrize(
    "text",
    [
        "PID(1)",
        "PID(kp=__import__('os').getpid())",
        "(lambda: 1)()",
        "taut.laws.PID(kp=1)",
        "PID(kp=open)",
        "PID(",
        "",
        "PID(**{})",
        "[PID(kp=1)]" * 900,
    ],
    ids=range(9),
)
def test_a_text_is_never_run_as_code(text: str) -> None:
    with refused(UsageError):
        law_of_text(text)


# -------------------------------------------------------------------- what is refused


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_what_cannot_be_compared_is_one_sentence(table: taut.analysis.Comparison, planar: taut.Loop) -> None:
    run = table.runs["PD"]
    for runs, error in (
        ([run] * 9, UsageError),
        ([], UsageError),
    ):
        with refused(error):
            taut.compare(runs)
    law = taut.laws.PID(kp=1.0)
    for laws, options, error in (
        ([law, law], {}, UsageError),
        (["PD"], {}, UnknownNameError),
        (law, {}, UsageError),
        ([law], {"by": "rms"}, UnknownNameError),
        ([law], {"case": "x"}, UsageError),
        (["TaskComputedTorque(kp=1, kd=1)"], {}, UsageError),
        (["PID(kp=[1, 2, 3])"], {}, UsageError),
    ):
        with refused(error):
            taut.compare(laws, planar, **options)
    with refused(UsageError):
        taut.compare([law], planar, model=3)  # type: ignore[arg-type]
    with refused(UsageError):
        taut.compare([law])
    with refused(UsageError):
        taut.compare(None, "gain_bounds")
    with refused(UsageError):
        taut.analysis.grade("PID(kp=1)", "wild: PID(kp=1e9, kd=1e7)", without_limits(planar))
    with refused(UsageError):
        taut.analysis.grade(run, law, planar)


@pytest.mark.parametrize(
    "numbers",
    [
        {"mass": -0.1},
        {"payload": -1.0},
        {"mass": 0.1, "trials": 0},
        {"mass": 0.1, "seed": 0.5},
        {"mass": 0.1, "trials": 1001},
        {"mass": 0.0, "trials": 3},
    ],
)
def test_numbers_of_a_wrong_model_that_have_no_meaning_are_refused(numbers: dict[str, float]) -> None:
    with pytest.raises((RangeError, UsageError)):
        taut.analysis.WrongModel(**numbers)


@pytest.mark.parametrize(
    "text",
    [
        "PID(kp=nan)",
        "PID(kp=-inf)",
        "PID(kp=[1, NaN])",
        "PID(kp=3-nan)",
        "ViaMit(law=PID(kp=-1, kd=2))",
        "ViaMit(law=PIDD(kp=1))",
        "ViaMit(law=Integral())",
        "ViaMit(kp_motor=1)",
        "Integral()",
    ],
)
def test_what_is_wrong_in_a_text_is_named(text: str) -> None:
    with refused(taut.TautError):
        law_of_text(text)


def test_an_unknown_gain_in_a_text_is_told() -> None:
    with refused(ScenarioError):
        law_of_text("PID(kp=1, kq=2)")
