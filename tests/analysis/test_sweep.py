"""taut.sweep: each sample is the run of its numbers, bit for bit, wherever and in whatever order it ran."""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from sweep_plants import Deadly

import taut
from taut.analysis.sweeps import chunks, workers
from taut.analysis.sweeps import sweep as front
from taut.analysis.sweeps.chunks import LaneRuns, SingleRuns, runner_of
from taut.analysis.sweeps.plan import Plan, Subject
from taut.cli.main import main
from taut.errors import FileError, MissingExtraError, RangeError, ShapeError, UnknownNameError, UsageError

L, S, D, T = taut.laws, taut.sensors, taut.drives, taut.trajectories
PLANAR, ONE = taut.load_arm("planar2"), taut.load_arm("one_joint")
TICKS = 40


def planar(law: taut.Law | None = None, **plant: Any) -> taut.Loop:
    ctrl = taut.compile(law or L.ComputedTorque(kp=100.0, kd=20.0), PLANAR)
    ref = T.Sine(center=PLANAR.home, amplitude=0.3, frequency=1.0)
    return taut.Loop(ctrl, taut.RigidPlant(PLANAR, **plant), ref, duration=(TICKS - 1) * 1e-3)


def noisy() -> taut.Loop:
    sensors = S.Sensors(position=S.Encoder(resolution=1e-4, noise=1e-4), velocity=None)
    ctrl = taut.compile(
        L.GravityPID(kp=[50.0, 40.0], kd=5.0, ki=20.0), PLANAR, sensing=taut.Sensing(velocity=S.Difference(cutoff=60.0)),
        limits=taut.Limits(tau=[4.0, 2.0], tau_dot=100.0),
    )  # fmt: skip
    plant = taut.RigidPlant(PLANAR.with_friction(taut.Friction(viscous=0.1, coulomb=0.2, static=0.3, stribeck=0.1)), sensors=sensors)  # fmt: skip
    return taut.Loop(ctrl, plant, taut.JointMotion(q=PLANAR.home + 0.1), duration=(TICKS - 1) * 1e-3)


def pressing() -> taut.Loop:
    """A planar arm that presses on a rigid plane with dry friction, and slides along it."""
    at = taut.snapshot(PLANAR, PLANAR.home).T().p
    contact = taut.RigidContact(constraint=taut.Constraint.plane(point=at, normal=[0.0, 0.0, 1.0]), friction=0.2)
    ctrl = taut.compile(L.GravityPID(kp=60.0, kd=6.0, ki=5.0), PLANAR)
    plant = taut.RigidPlant(PLANAR, contact=contact, friction=None)
    return taut.Loop(ctrl, plant, taut.JointMotion(q=PLANAR.home + np.array([0.2, 0.3])), duration=(TICKS - 1) * 1e-3)


def elastic() -> taut.Loop:
    """Elastic joints in four steps of the integrator a tick."""
    arm = PLANAR.with_gears(ratio=50.0, motor_inertia=1e-4)
    gears = D.Transmission(stiffness=2000.0, damping=1.0)
    plant = taut.RigidPlant(arm, actuation=D.Actuation(transmission=gears), substeps=4)
    ctrl = taut.compile(L.GravityPID(kp=20.0, kd=4.0), arm)
    return taut.Loop(ctrl, plant, taut.hold(), duration=(TICKS - 1) * 1e-3)


def task_space() -> taut.Loop:
    arm = taut.load_arm("ur10")
    ctrl = taut.compile(L.Impedance(K=(400.0, 20.0), B=(6.0, 0.6)), arm)
    return taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), None, duration=(TICKS - 1) * 1e-3)


Make = Callable[[], taut.Loop]
U = taut.uniform
CASES: dict[str, tuple[Make, dict[str, Any]]] = {
    "gains, payload and state": (planar, {"law.kp": U(50.0, 400.0), "plant.payload.mass": U(0.0, 2.0), "q0": U([-0.3, 0.2], [0.3, 1.0])}),
    "noise, quantisation, friction, limits": (noisy, {"law.kp[1]": U(20.0, 80.0), "sensors.position.noise": U(1e-5, 1e-3)}),
    "rigid contact": (pressing, {"law.kp": U(50.0, 100.0), "plant.payload.mass": U(0.0, 2.0)}),
    "sub-steps, a hold of each start": (elastic, {"q0[0]": U(-0.5, 0.5), "actuation.transmission.stiffness": U(1500.0, 3000.0)}),
    "impedance": (task_space, {"law.K": U([200.0] * 6, [400.0] * 6), "model.payload.mass": U(0.0, 2.0)}),
    "a reference of each": (planar, {"ref.amplitude": U(0.1, 0.4), "ref.frequency[1]": U(0.5, 2.0), "v0[1]": U(-1.0, 1.0)}),
}  # fmt: skip


def plan_of(loop: taut.Loop, vary: Any, samples: int = 6, **more: Any) -> Plan:
    subject = Subject.of(loop, loop.plant, loop.ref, loop.duration, None, None)
    return dataclasses.replace(Plan.of(subject, vary, samples, 3), **more)


# -------------------------------------------------------------------- bits


@pytest.mark.part(1)
@pytest.mark.parametrize("case", CASES)
def test_a_sample_is_the_run_of_its_numbers_bit_for_bit(case: str) -> None:
    make, vary = CASES[case]
    plan = plan_of(loop := make(), vary, record=("q", "v", "tau", "command"))
    runner = runner_of(plan, loop)
    assert isinstance(runner, LaneRuns)
    found, again = runner.results(0, 6), SingleRuns(plan).results(0, 6)
    assert found.table["outcome"].tolist() == ["completed"] * 6, again.messages
    for name, column in again.rows.items():
        np.testing.assert_array_equal(found.rows[name], column, err_msg=name)
    moved = next(name for name in found.rows if name.startswith("v."))
    assert len(np.unique(found.rows[moved])) > 100


@pytest.mark.part(1)
@pytest.mark.parametrize("case", ["gains, payload and state", "noise, quantisation, friction, limits", "impedance"])
def test_metrics_summed_up_on_the_way_are_those_of_the_runs(case: str) -> None:
    make, vary = CASES[case]
    found = taut.sweep(make(), vary, samples=5, seed=1, workers=1)
    assert found.plan.columns
    every = [name for name in front.STREAMS if front._has(found.run(0), name)]
    whole = taut.sweep(make(), vary, samples=5, seed=1, workers=1, metrics=every)
    assert {"rms_error", "chatter", "effort"} <= set(every) or "task_rms" in every
    for i, name in itertools.product(range(5), every):
        expected = found.run(i).metrics.overall(name)
        assert whole.table[name][i] == pytest.approx(expected, rel=1e-9, abs=1e-12), name
        if name in found.plan.columns:
            assert found.table[name][i] == whole.table[name][i]


def test_a_metric_of_ones_own_is_that_of_whole_runs() -> None:
    @taut.analysis.Metric(unit="rad/s")
    def third_speed(run: taut.Run) -> float:
        return float(np.abs(run.v[3]).max())

    vary = {"law.kp": U(50.0, 400.0)}
    found = taut.sweep(planar(), vary, samples=9, metrics=["third_speed", "rms_error"], workers=2)
    assert found.table["third_speed"].tolist() == [third_speed(found.run(i)) for i in range(9)]
    summed = taut.sweep(planar(), vary, samples=9, metrics=["rms_error"])
    np.testing.assert_allclose(found.table["rms_error"], summed.table["rms_error"], rtol=1e-12)


def tables_equal(a: Any, b: Any) -> bool:
    def content(column: Any) -> Any:
        return column.tolist() if column.dtype == object else column.tobytes()

    return list(a) == list(b) and all(content(a[name]) == content(b[name]) for name in a)


def test_neither_lanes_nor_workers_nor_the_order_of_chunks_change_a_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "IN_LANES", (16, 16))
    vary = {"law.kp[0]": U(20.0, 80.0), "plant.payload.mass": taut.normal(1.0, 0.1)}
    found = taut.sweep(noisy(), vary, samples=100, seed=5, workers=1).table
    for count, threads in ((1, 1), (2, 2), (8, 8)):
        monkeypatch.setattr(chunks, "host_lanes", lambda _, count=count: count)
        assert tables_equal(taut.sweep(noisy(), vary, samples=100, seed=5, workers=threads).table, found)
    run = workers.run_chunks
    monkeypatch.setattr(front, "run_chunks", lambda plan, shared, n, todo: run(plan, shared, n, todo[::-1]))
    assert tables_equal(taut.sweep(noisy(), vary, samples=100, seed=5, workers=2).table, found)
    fewer = taut.sweep(noisy(), vary, samples=40, seed=5).table
    assert all(np.array_equal(fewer[name], found[name][:40]) for name in fewer)


def test_a_run_that_diverges_is_flagged_and_no_other_one_sees_it() -> None:
    kd = np.full(30, 20.0)
    healthy = taut.sweep(planar(), {"law.kd": kd}, samples=30)
    kd[[4, 17]] = 1e9
    found = taut.sweep(planar(), {"law.kd": kd}, samples=30)
    assert np.flatnonzero(~found.completed).tolist() == [4, 17]
    assert (found.table["outcome"][[4, 17]] == "diverged").all()
    again = found.run(4)
    assert again.outcome.kind == "diverged"
    assert abs(int(found.table["ticks"][4]) - len(again)) <= 1
    assert np.isfinite(found.table["rms_error"]).all()  # up to there
    for name in healthy.plan.columns:
        np.testing.assert_array_equal(np.delete(found.table[name], [4, 17]), np.delete(healthy.table[name], [4, 17]))
    assert "2 diverged" in str(found)


def test_single_precision_has_its_rounding() -> None:
    vary = {"law.kp": U(50.0, 400.0), "plant.payload.mass": U(0.0, 2.0)}
    double, single = (taut.sweep(planar(), vary, samples=50, real=real) for real in ("double", "float"))
    np.testing.assert_array_equal(single.table["law.kp"], double.table["law.kp"])
    for name in ("rms_error", "peak_torque"):
        assert not np.array_equal(single.table[name], double.table[name])
        np.testing.assert_allclose(single.table[name], double.table[name], rtol=1e-4)


# -------------------------------------------------------------------- what is drawn


def test_samples_follow_their_distributions() -> None:
    n = 4000
    vary = {
        "law.kp": U(50.0, 400.0), "law.kd": taut.log_uniform(1.0, 100.0), "plant.payload.mass": taut.normal(0.5, 1.0, low=0.0),
        "q0": U([-1.0, 0.5], [1.0, 0.6]), "ref.phase": taut.choice([0.0, 0.5]),
    }  # fmt: skip
    drawn = plan_of(planar(), vary, samples=n).drawn(0, n)
    assert all(np.isfinite(x).all() for x in drawn.values())
    kp, kd, mass = (drawn[name] for name in ("law.kp", "law.kd", "plant.payload.mass"))
    assert abs(np.mean(kp) - 225.0) < 5.0 * 350.0 / np.sqrt(12.0 * n)
    assert 50.0 <= kp.min() < 52.0
    assert abs(np.mean(np.log10(kd)) - 1.0) < 5.0 * 2.0 / np.sqrt(12.0 * n)
    assert 0.0 <= mass.min() < 5e-3
    assert abs(np.mean(mass) - 1.0092) < 0.06  # of a normal number cut at half a deviation below its mean
    assert drawn["q0"].shape == (n, 2)
    assert abs(np.corrcoef(drawn["q0"].T)[0, 1]) < 5.0 / np.sqrt(n)
    assert abs(np.mean(drawn["ref.phase"] == 0.5) - 0.5) < 2.5 / np.sqrt(n)
    assert len(np.unique(drawn["seed"])) == n
    one = plan_of(planar(), {"law.kp": vary["law.kp"]}, samples=n).drawn(1500, 10)  # what else varies changes nothing
    np.testing.assert_array_equal(one["law.kp"], kp[1500:1510])


def test_noise_is_new_in_each_sample_unless_its_seed_is_given() -> None:
    same = taut.sweep(noisy(), {"seed": [7] * 3}, samples=3)
    assert len(set(same.table["effort"])) == 1
    assert np.array_equal(same.run(2).q, taut.run(noisy(), seed=7).q)
    assert len(set(taut.sweep(noisy(), {}, samples=3).table["effort"])) == 3


# -------------------------------------------------------------------- files


def kept_by(monkeypatch: pytest.MonkeyPatch, limit: int | None = None) -> list[int]:
    """The chunks that are run from now on, by first sample; after `limit` of them somebody presses Ctrl-C."""
    begun: list[int] = []
    results = LaneRuns.results

    def counted(self: Any, first: int, count: int, step: Any = None) -> Any:
        begun.append(first)
        return results(self, first, count)

    monkeypatch.setattr(LaneRuns, "results", counted)
    if limit is not None:
        advance = front.Progress.advance

        def interrupted(self: Any, steps: int) -> None:
            advance(self, steps)
            if self._what == "sweeping" and self._done >= limit:
                raise KeyboardInterrupt

        monkeypatch.setattr(front.Progress, "advance", interrupted)
    return begun


def test_a_sweep_that_was_interrupted_goes_on_where_it_stopped(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(chunks, "IN_LANES", (8, 8))
    vary, more = (
        {"law.kp": U(50.0, 400.0), "q0": U([-0.3, 0.2], [0.3, 1.0])},
        {"samples": 60, "seed": 2, "workers": 1},
    )
    whole = taut.sweep(planar(), vary, **more)
    with monkeypatch.context() as patch:
        kept_by(patch, limit=24)
        part = taut.sweep(planar(), vary, **more, out=tmp_path / "a")
    assert (part.complete, part.samples) == (False, 24)
    assert np.array_equal(part.table["rms_error"], whole.table["rms_error"][:24])
    (tmp_path / "a" / "chunk-0000000008.parquet").unlink()
    with monkeypatch.context() as patch:
        begun = kept_by(patch)
        done = taut.sweep(planar(), vary, **more, out=tmp_path / "a")
    assert sorted(begun) == [8, 24, 32, 40, 48, 56]
    assert (done.complete, done.samples) == (True, 60)
    for name in ("sample", "law.kp", "seed", "outcome", "ticks", *whole.plan.columns):
        assert done.table[name].tolist() == whole.table[name].tolist()
    for changed in ({"seed": 3}, {"samples": 61}, {"metrics": ["rms_error"]}):
        with refused(FileError):
            taut.sweep(planar(), vary, **{**more, **changed}, out=tmp_path / "a")
    loop = planar()
    loop.parameters["law.kd"] = 21.0
    with refused(FileError):
        taut.sweep(loop, vary, **more, out=tmp_path / "a")


def test_whole_runs_go_to_files(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    vary = {"law.kp": U(50.0, 400.0)}
    found = taut.sweep(noisy(), vary, samples=10, out=tmp_path, record=("q", "terms.P"), every=4)
    rows = parquet.read_table(tmp_path / "rows-0000000000.parquet").to_pydict()
    run = found.run(7)
    own = np.array(rows["sample"]) == 7
    assert list(rows) == ["sample", "t", "q.joint1", "q.joint2", "terms.P.joint1", "terms.P.joint2"]
    np.testing.assert_array_equal(np.array(rows["t"])[own], run.t[::4])
    np.testing.assert_array_equal(np.array(rows["q.joint2"])[own], run.q[::4, 1])
    np.testing.assert_array_equal(np.array(rows["terms.P.joint1"])[own], run.terms["P"][::4, 0])


def test_a_disk_that_is_full_ends_a_sweep_and_keeps_what_was_done(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(chunks, "IN_LANES", (8, 8))
    write, calls = front.Store.write, []

    def full(self: Any, results: Any) -> None:
        calls.append(results)
        if len(calls) > 2:
            monkeypatch.setattr(self.arrow.parquet, "write_table", no_space)
        write(self, results)

    def no_space(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(front.Store, "write", full)
    with refused(FileError):
        taut.sweep(planar(), {"law.kp": U(50.0, 400.0)}, samples=40, out=tmp_path / "a", workers=1)
    assert len(list((tmp_path / "a").glob("chunk-*.parquet"))) == 2
    assert not list((tmp_path / "a").glob(".*"))


# -------------------------------------------------------------------- processes


def test_workers_that_die_hang_or_raise_leave_each_sample_with_one_result(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(workers, "SAMPLE_PATIENCE", 2.0)
    monkeypatch.setattr(chunks, "ONE_BY_ONE", (2, 2))
    q0 = np.full(8, 0.0)
    q0[1:5] = 1.0, 2.0, 3.0, 4.0
    q0 += 1e-3 * np.arange(8)
    ctrl = taut.compile(L.PID(kp=8.0, kd=8.0), ONE)
    begin = {"duration": 0.02, "samples": 8, "metrics": ["final_error"]}
    found = taut.sweep(
        ctrl, {"q0": q0}, Deadly(ONE, str(tmp_path)), taut.JointMotion(q=[0.0]), workers=2, q0=[0.5], **begin
    )
    assert found.table["sample"].tolist() == list(range(8))
    assert found.table["outcome"][1:6].tolist() == ["failed", "failed", "failed", "completed", "completed"]
    assert found.complete
    assert found.completed.sum() == 5
    assert sorted(found.messages) == [1, 2, 3]
    assert "status -9" in found.messages[1]
    assert "did not answer" in found.messages[2]
    assert "the plant fails" in found.messages[3]
    healthy = np.flatnonzero(found.completed)
    alone = SingleRuns(found.plan)
    for i in healthy[[0, -1]]:
        assert alone.results(int(i), 1).table["final_error"][0] == found.table["final_error"][i]


def test_a_loop_with_mujoco_is_the_same_in_one_process_and_in_several(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "ONE_BY_ONE", (2, 2))
    arm = PLANAR.with_friction(taut.Friction())
    sensors = S.Sensors(position=S.Encoder(noise=1e-4))
    ctrl = taut.compile(L.GravityPID(kp=50.0, kd=10.0), arm)
    vary = {"plant.payload.mass": U(0.0, 2.0), "law.kp": U(30.0, 60.0)}
    several, one = (
        taut.sweep(
            ctrl, vary, taut.MujocoPlant(arm, sensors=sensors), taut.JointMotion(q=[0.1, 0.2]), duration=0.05,
            samples=6, workers=n,
        )
        for n in (2, 1)
    )  # fmt: skip
    assert tables_equal(several.table, one.table)
    assert several.completed.all()
    assert several.run(5).metrics.overall("rms_error") == several.table["rms_error"][5]


# -------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("error", "vary"),
    [
        (UnknownNameError, {"law.kpp": U(1.0, 2.0)}),
        (UnknownNameError, {"ref.amplitud": U(1.0, 2.0)}),
        (UnknownNameError, {"plant.mass": U(1.0, 2.0)}),
        (RangeError, {"plant.payload.mass": U(-0.5, 1.0)}),
        (RangeError, {"plant.payload.mass": taut.normal(1.0, 0.3)}),
        (RangeError, {"law.kp": [100.0, -1.0, 5.0]}),
        (RangeError, {"q0[1]": [0.0, np.nan, 1.0]}),
        (RangeError, {"seed": [0, 1, -2]}),
        (ShapeError, {"law.kp": U([1.0, 1.0, 1.0], [2.0, 2.0, 2.0])}),
        (ShapeError, {"law.kp": [1.0, 2.0]}),
        (ShapeError, {"q0[2]": U(0.0, 1.0)}),
        (UsageError, [("law.kp", U(0.0, 1.0))]),
        (UsageError, {"q0[1]": U(0.0, 1.0), "q0": U(0.0, 1.0)}),
    ],
)
def test_what_the_loop_refuses_is_refused_before_the_first_sample(
    error: Any, vary: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("a run began")

    monkeypatch.setattr(front, "run", never)
    with refused(error):
        taut.sweep(planar(), vary, samples=3)


def test_a_start_that_the_plant_refuses_is_refused_too() -> None:
    with refused(RangeError):  # off the plane that it touches
        taut.sweep(pressing(), {"q0[1]": U(-0.3, 0.3)}, samples=3)


@pytest.mark.parametrize(
    ("error", "make"),
    [
        (RangeError, lambda: taut.uniform(2.0, 1.0)),
        (RangeError, lambda: taut.uniform(0.0, np.inf)),
        (ShapeError, lambda: taut.uniform([0.0, 0.0], 1.0)),
        (RangeError, lambda: taut.log_uniform(0.0, 1.0)),
        (RangeError, lambda: taut.normal(0.0, 0.0)),
        (RangeError, lambda: taut.normal(0.0, 1.0, low=2.0, high=1.0)),
        (ShapeError, lambda: taut.normal([0.0, 1.0], [1.0, 1.0, 1.0])),
        (UsageError, lambda: taut.choice([])),
        (RangeError, lambda: taut.sweep(planar(), {}, samples=0)),
        (UnknownNameError, lambda: taut.sweep(planar(), {}, samples=1, metrics=["rms_eror"])),
        (RangeError, lambda: taut.sweep(planar(), {}, samples=1, metrics=["task_rms"])),
        (UsageError, lambda: taut.sweep(planar(), {}, samples=1, record=["q"])),
        (UnknownNameError, lambda: taut.sweep(planar(), {}, samples=1, record=["qq"], out="nowhere")),
        (RangeError, lambda: taut.sweep(planar(), {}, samples=1, workers=0)),
        (UsageError, lambda: taut.sweep(planar(), {}, samples=1, ray="local")),
        (UsageError, lambda: taut.sweep(planar(), {}, samples=1, ray=True)),  # type: ignore[arg-type]
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused(error: Any, make: Callable[[], Any]) -> None:
    with refused(error):
        make()


def test_what_cannot_be_sent_to_a_process_is_refused(tmp_path: Path) -> None:
    class Own(taut.Law):
        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
            return taut.Torque(P=ref.q - x.q)

    ctrl = taut.compile(Own(), ONE)
    with refused(UsageError):
        taut.sweep(
            ctrl, {}, Deadly(ONE, str(tmp_path)), taut.JointMotion(q=[0.0]), duration=0.01, samples=2, workers=2
        )
    assert taut.sweep(ctrl, {}, Deadly(ONE, str(tmp_path)), duration=0.01, samples=2, workers=1).completed.all()
    assert os.path.exists(tmp_path / "begun")  # noqa: PTH110


def test_a_sweep_on_a_cluster_needs_ray(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with refused(MissingExtraError):
        taut.sweep(planar(), {}, samples=1, ray="auto")
    words = ["sweep", "one_joint_pid", "--law", "PD", "--vary", "law.kp=1:9", "--ray", "local"]
    with refused(UsageError):
        assert main(words) == 2
        raise UsageError(capsys.readouterr().err.strip())


# -------------------------------------------------------------------- the command


def test_the_command_sweeps_a_scenario(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["sweep", "one_joint_pid", "--law", "PD", "--set", "run.duration=0.1", "--samples", "1e2", "--seed", "4"]
    words += ["--vary", "law.kp=1:9", "--vary", "plant.payload.mass=0,0.5", "--metric", "rms_error"]
    assert main([*words, "--json", "--out", str(tmp_path / "a")]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["law"], data["samples"], data["complete"]) == ("PD", 100, True)
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "100 completed" in text
    row = data["tables"]["metrics of the runs that came to their end"][0]
    assert f"{row['50 %']:.4g}" in text
    names = sorted(file.name for file in (tmp_path / "a").iterdir())
    assert [name for name in names if name.startswith("chunk")] == [
        "chunk-0000000000.parquet",
        "chunk-0000000064.parquet",
    ]
    assert {"report.html", "sweep.json", "worst.toml"} < set(names)


@pytest.mark.parametrize(
    "words",
    [
        ["one_joint_pid", "--vary", "law.kp=1:9"],
        ["one_joint_pid", "--law", "PD", "--vary", "law.kp"],
        ["one_joint_pid", "--law", "PD", "--vary", "law.kp=9:1"],
        ["one_joint_pid", "--law", "PD", "--vary", "law.kq=1:9"],
        ["one_joint_pid", "--law", "PD", "--samples", "1.5"],
        ["panda_pushed"],
    ],
)
def test_wrong_words_of_the_command_are_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with refused(UsageError):
        assert main(["sweep", *words]) == 2
        raise UsageError(capsys.readouterr().err.strip())
