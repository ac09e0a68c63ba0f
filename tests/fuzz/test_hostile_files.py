"""Files that somebody else made: nothing in them commands a terminal, costs much, or raises what is not ours."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzz_kinds import MJCF, SERVOS, runs
from fuzz_logs import chunk, record, with_chunks, write_log
from refusals import refused

import taut
from taut.analysis import Check
from taut.arm.catalogue import CATALOGUE, installed_package
from taut.arm.report import check_model
from taut.base.errors import printable
from taut.cli.main import main
from taut.control.trajectories.compound import PhaseSample
from taut.record.info import RunInfo
from taut.record.log.reading import MAGIC
from taut.scenarios.scenario import load_scenario

HIDDEN = "\x1b]0;taken\x07\u202e\x9b31m"  # sets a title, turns the reading order, colours
DUO = Path(__file__).parents[1] / "arm" / "arm_models.py"


@contextmanager
def memory_below(megabytes: float) -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < megabytes * 2**20
    finally:
        tracemalloc.stop()


def plain() -> taut.Run:
    return runs()[0]


# -------------------------------------------------------------------- terminals


def test_what_cannot_be_seen_is_written_out() -> None:
    assert printable("a b ü 関節 ²") == "a b ü 関節 ²"
    assert printable(f"{HIDDEN}\n\t\ud800") == "\\x1b]0;taken\\x07\\u202e\\x9b31m\\n\\t\\ud800"
    assert printable("a\n\tb\r", lines=True) == "a\n\tb\\r"
    assert str(taut.errors.FileError(f"log '{HIDDEN}'")).isprintable()


def test_a_log_commands_no_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import dataclasses

    names = (f"one{HIDDEN}", "two\n")
    terms = {f"{name}{HIDDEN}": column for name, column in plain().terms.items()}
    outcome = taut.Outcome(kind="completed", message=f"completed{HIDDEN}", tick=100)
    run = dataclasses.replace(
        plain(),
        joint_names=names,
        terms=terms,
        outcome=outcome,
        info=dataclasses.replace(plain().info, law=HIDDEN, arm=HIDDEN),
    )
    log = run.save(tmp_path / "run.mcap")
    again = taut.load_run(log)
    assert len(again) == len(run)
    assert all(name.isprintable() for name in (*again.joint_names, *again.terms, again.outcome.message))
    main(["doctor", str(log)])
    main(["report", str(log), "--out", str(tmp_path / "report.html")])
    said = capsys.readouterr()
    assert (said.out + said.err).replace("\n", "").isprintable()


def test_whatever_is_printed_is_written_as_text(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import taut.arm.report

    monkeypatch.setattr(taut.arm.report.CheckReport, "text", lambda report: f"{report.name}\n{HIDDEN}")
    assert main(["check", "planar2"]) == 0
    assert main(["check", f"no{HIDDEN}.urdf"]) == 2  # a path is the caller's own, and may be anything
    assert main([HIDDEN]) == 2
    said = capsys.readouterr()
    assert printable(HIDDEN) in said.out
    assert (said.out + said.err).replace("\n", "").isprintable()


@pytest.mark.parametrize("letter", ["\x9b", "\u202e", "\x7f", "\u200b", "&#10;"])
def test_a_model_has_no_invisible_characters(letter: str, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(MJCF.replace('name="j1"', f'name="j{letter}1"'), encoding="utf-8")
    with pytest.raises(taut.errors.ModelError) as refused:
        taut.load_arm(tmp_path / "arm.xml")
    assert (refused.value.problems[0].attribute, refused.value.problems[0].line) == ("name", 4)


@pytest.mark.parametrize("text", ['title = "a\\u001b[2J"', '"a\\u202e" = 1', '[laws."\\u009b"]\nlaw = "PID"'])
def test_a_scenario_has_no_invisible_characters(text: str, tmp_path: Path) -> None:
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    with pytest.raises(taut.errors.ScenarioError) as refused:
        load_scenario(str(tmp_path / "case.toml"))
    assert str(refused.value).isprintable()


def test_a_matplotlibrc_of_the_current_folder_is_ignored(tmp_path: Path) -> None:
    log = plain().save(tmp_path / "run.mcap")
    (tmp_path / "matplotlibrc").write_bytes(b"text.usetex: True\n\xff\xfe")
    command = [sys.executable, "-c", "import sys; from taut.cli.main import main; sys.exit(main())", "report"]
    done = subprocess.run([*command, log.name, "--out", "r.html"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "r.html").stat().st_size > 1000


# -------------------------------------------------------------------- logs


def classes(name: str, count: int) -> Callable[[dict[str, Any]], None]:
    part = {"name": name, "kind": name, "joints": 0}
    return lambda values: values.update(reference="PhaseSample", parts=[part] * count)


DESCRIPTIONS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "16 kinds": classes("JointMotion", 16),
    "1000 kinds": classes("JointMotion", 1000),
    "parts of odd names": lambda v: v.update(parts=[{"name": "a b", "kind": "JointMotion", "joints": 2}]),
    "a part of many joints": lambda v: v.update(parts=[{"name": "a", "kind": "JointMotion", "joints": 10**400}]),
    "100,000 axes": lambda v: v["extra"].update(e=[0] * 100_000),
    "a size beyond a word": lambda v: v["extra"].update(e=[2**62, 0]),
    "an empty array too large": lambda v: v["extra"].update(e=[2**31] * 7 + [0]),
    "no kind": lambda v: v.update(kind=[]),
    "many columns": lambda v: v.update(terms=[str(i) for i in range(100_000)]),
    "many values": lambda v: v["info"].update(x=[[]] * 1_000_001),
    "deep": lambda v: v["info"].update(x=json.loads("[" * 900 + "]" * 900)),
    "no table": lambda v: [1, 2],
}


@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_a_description_costs_little_and_is_refused(name: str, tmp_path: Path) -> None:
    log = write_log(plain(), tmp_path / "run.mcap", DESCRIPTIONS[name])
    known = len(PhaseSample.__subclasses__())
    with memory_below(150), pytest.raises(taut.errors.FileError):
        taut.load_run(log)
    assert len(PhaseSample.__subclasses__()) - known <= 64


def test_a_log_of_a_task_with_many_kinds_of_reference_is_read(tmp_path: Path) -> None:
    task = runs()[1]
    assert type(taut.load_run(task.save(tmp_path / "run.mcap")).reference) is type(task.reference)


BOMBS: dict[str, Callable[[], bytes]] = {
    "twenty of 31 MB": lambda: chunk(bytes(31 << 20)) * 20,
    "empty messages": lambda: chunk(record(5, bytes(22)) * (1 << 20)) * 20,
    "empty records": lambda: chunk(record(3, b"") * (3 << 20)) * 20,
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_log_that_unpacks_to_more_than_a_log_does_is_refused(name: str, tmp_path: Path) -> None:
    log = with_chunks(write_log(plain(), tmp_path / "run.mcap"), BOMBS[name]())
    with memory_below(150), pytest.raises(taut.errors.FileError):
        taut.load_run(log)


def test_a_chunk_that_unpacks_to_more_than_it_says_is_damage(tmp_path: Path) -> None:
    log = with_chunks(write_log(plain(), tmp_path / "run.mcap"), chunk(bytes(100 << 20), size=1000))
    with memory_below(50):
        again = taut.load_run(log)
    assert (len(again), again.outcome.kind) == (len(plain()), "completed")
    assert "damaged" in again.outcome.message


def test_a_sparse_file_is_searched_only_so_far(tmp_path: Path) -> None:
    with (tmp_path / "run.mcap").open("wb") as file:
        file.write(MAGIC)
        file.truncate(4 << 30)
    with memory_below(50), pytest.raises(taut.errors.FileError):
        taut.load_run(tmp_path / "run.mcap")
    log = plain().save(tmp_path / "whole.mcap")
    with log.open("r+b") as file:
        file.truncate(4 << 30)
    again = taut.load_run(log)
    assert len(again) == len(plain())


SERVO = {"digest": "0" * 128, "measures": [], "limits": {}, "adds": {}}
ENTRIES: dict[str, Any] = {
    "rate": ["x", 0.0, -1.0, float("inf"), [1000.0]],
    "law": [None, 3, []],
    "arm": [{}],
    "seed": ["0", 1.5, -1],
    "events": [{}, [1], [{"t": "x", "set": {}}], [{"t": 0.0, "set": {"model.payload.com": 1.0}}]],
    "parameters": [[], {"law.kp": "x"}, {"law.kp": [[1.0], [1.0, 2.0]]}, {"model.payload.mass": [1.0]}],
    "limits": [[], {"effort": 3}, {"effort": {"joint1": "x"}}],
    "controller_arm": [[], {}, {"gravity": [0, 0, 0], "bodies": [[1.0]], "home": [0, 0]}],
    "tool": [[], {}, "x", {"frame": "tool", "n": 2, "links": [{"joint": 9}]}],
    "impedance": [{}, {"D": np.zeros((6, 6)).tolist(), "B": np.eye(6).tolist(), "K": np.eye(6).tolist()}],
    "parts": [{"left": {"joints": ["other"]}}, []],
    "phases": [{"go": {}}, []],
    "scenario": [{"name": 3}, "x"],
    "versions": [[], {"taut": 1}],
    "servo": [
        [],
        {},
        *({**SERVO, name: value} for name, value in (("measures", ["q", "x"]), ("limits", 3), ("adds", []))),
    ],
    "around": [[], {"things": 3}, {"meshes": [{"vertices": "?", "faces": ""}]}],
    "unheard": [1],
}


@pytest.mark.parametrize("name", ENTRIES)
def test_an_entry_of_another_type_is_refused_where_the_log_is_read(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for value in ENTRIES[name]:
        log = write_log(
            plain(), tmp_path / "run.mcap", lambda values, value=value: values["info"].update({name: value})
        )
        for command in (["doctor"], ["report", "--out", str(tmp_path / "report.html")]):
            assert main([command[0], str(log), *command[1:]]) == 2, value
            assert name in capsys.readouterr().err


def test_an_outcome_of_other_types_is_none(tmp_path: Path) -> None:
    for change in ({"kind": []}, {"kind": "fine"}, {"message": 3}, {"tick": "x"}, {"joint": 1}):
        log = write_log(
            plain(), tmp_path / "run.mcap", ended=lambda values, change=change: values["outcome"].update(change)
        )
        assert taut.load_run(log).outcome.kind == "stopped"


def test_a_run_without_a_rate_says_so() -> None:
    import dataclasses

    with refused(taut.errors.UsageError):
        taut.doctor(dataclasses.replace(plain(), info=RunInfo()))


# -------------------------------------------------------------------- tables and scenarios


def test_a_table_is_bounded(tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    with file.open("wb") as stream:
        stream.write(b"t,q1\n0,1\n")
        stream.truncate(1 << 30)
    with memory_below(10), pytest.raises(taut.errors.FileError):
        taut.trajectories.Samples.from_csv(file)
    file.write_bytes(b"t,q1\n0,1\n1," + bytes(10 << 20))
    with pytest.raises(taut.errors.FileError) as refused:
        taut.trajectories.Samples.from_csv(file)
    assert len(str(refused.value)) < 1000


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 30_000 + " = 1",
        '"a b"' + '."a!b"' * 30_000 + " = 1",
        "[" + "a." * 90_000 + "a]",
        "x = { " + "a . " * 90_000 + "a = 1 }",
    ],
    ids=range(4),
)
def test_a_dotted_key_is_refused_before_it_is_read(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import tomllib

    def never(text: str) -> dict[str, Any]:
        raise AssertionError("the parser was asked")

    monkeypatch.setattr(tomllib, "loads", never)
    (tmp_path / "case.toml").write_text(text)
    with refused(taut.errors.ScenarioError):
        load_scenario(str(tmp_path / "case.toml"))


def test_dots_in_texts_comments_and_numbers_are_no_keys(tmp_path: Path) -> None:
    from taut.scenarios.reading import read_toml

    words = "a." * 100
    text = f'a = "{words}" # {words}\nb = """{words}\n{words}"""\nc = [{"0.1, " * 100}]\nd = \'{words}\'\n'
    (tmp_path / "case.toml").write_text(text)
    assert list(read_toml(tmp_path / "case.toml").values) == ["a", "b", "c", "d"]


def test_the_cases_of_a_scenario_are_counted(tmp_path: Path) -> None:
    text = '[arm]\nmodel = "one_joint"\n[laws.PID]\nlaw = "PID"\nkp = 1\n[run]\nduration = 1\n'
    text += '[plant]\n[reference]\nkind = "hold"\n'
    (tmp_path / "case.toml").write_text(text + "".join(f"[cases.c{i}.run]\n" for i in range(201)))
    with refused(taut.errors.ScenarioError):
        load_scenario(str(tmp_path / "case.toml"))


@pytest.mark.parametrize("name", ["../x", "a b", "1", "parts", "fields", "self", "__init__", "motion"])
def test_a_part_is_named_by_a_word_of_its_own(name: str) -> None:
    law = taut.laws.GravityPID(kp=1.0, kd=1.0)
    parts: Any = {name: (law, ["joint1"])}
    if name != "self":
        with pytest.raises(taut.errors.UsageError):
            taut.together(**{name: taut.JointMotion(q=[0.0])})
        with pytest.raises(taut.errors.UsageError):
            taut.SideBySide(**parts)
    else:
        assert taut.SideBySide(**parts).parts == {"self": law}


# -------------------------------------------------------------------- models and servos


def urdf(origin: str = "0 0 0", com: str = "0.1 0 0", mass: str = "1", moment: str = "0.01", limit: str = "2") -> str:
    inertial = f'<inertial><origin xyz="{com}"/><mass value="{mass}"/>' + (
        f'<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    joint = (
        '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}"/>'
        f'<axis xyz="0 1 0"/><limit lower="-{limit}" upper="{limit}" velocity="1" effort="1"/></joint>'
    )
    light = inertial.replace(com, "0.1 0 0").replace(f'"{mass}"', '"1"').replace(f'"{moment}"', '"0.01"')
    links = f'<link name="base"/><link name="a">{light}</link><link name="b">{inertial}</link>'
    return f'<robot name="r">{links}{joint.format("j1", "base", "a", "0 0 0")}{joint.format("j2", "a", "b", origin)}</robot>'


@pytest.mark.parametrize(
    "change", [{"origin": "1e8 0 0"}, {"com": "1e5 0 0"}, {"mass": "1e9", "com": "5000 0 0", "moment": "1e9"}]
)
def test_lengths_and_masses_that_leave_no_mass_matrix_are_refused(change: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(urdf(**change))
    with pytest.raises(taut.errors.ModelError):
        taut.load_arm(tmp_path / "arm.urdf")


def test_a_long_boom_is_an_arm(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(urdf(origin="100 0 0", mass="1e5", moment="1e6"))
    assert taut.load_arm(tmp_path / "arm.urdf").n == 2


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"limit": "115"}, "degrees"),
        ({"mass": "800", "origin": "0.25 0 0"}, "in g"),
        ({"mass": "0.8", "moment": "3", "origin": "0.25 0 0"}, "radius of gyration"),
        ({"mass": "20", "moment": "1e-6"}, "dense"),
    ],
)
def test_numbers_in_other_units_are_doubted(change: dict[str, str], word: str, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(urdf(**change))
    report = check_model(tmp_path / "arm.urdf")
    assert report.ok
    assert any(word in note for note in report.notes)
    (tmp_path / "arm.urdf").write_text(urdf(origin="0.25 0 0"))
    assert check_model(tmp_path / "arm.urdf").notes == ()


def test_no_arm_of_the_catalogue_is_doubted() -> None:
    for name, entry in CATALOGUE.items():
        if installed_package(entry):
            notes = " ".join(check_model(name).notes)
            assert not any(word in notes for word in ("degrees", "in g?", "gyration", "dense")), name


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('timestep="0.002"', 'timestep="-0.001"'),
        ('stiffness="0"', 'stiffness="-5"'),
        ('density="800"', 'density="-1"'),
        ('range="0 0.2"', 'range="0 1e300"'),
        ('range="-2 2"', 'range="0 1e300"'),
        ("<worldbody>", f'<include file="{"a" * 5000}"/><worldbody>'),
    ],
)
def test_mjcf_that_no_arm_has_is_refused(old: str, new: str, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(MJCF.replace(old, new))
    with pytest.raises(taut.errors.ModelError) as refused:
        taut.load_arm(tmp_path / "arm.xml")
    assert refused.value.problems[0].line is not None


def test_a_spring_of_mjcf_is_noted(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(MJCF.replace('stiffness="0"', 'stiffness="5"'))
    assert any("springs left out" in note for note in taut.load_arm(tmp_path / "arm.xml").notes)


@pytest.mark.parametrize("change", [{"kt": 1e-320}, {"R": 1e-320}, {"armature": 1e-320}, {"kt": 1e300}])
def test_servos_of_odd_numbers_are_read(change: dict[str, float], tmp_path: Path) -> None:
    for values in SERVOS:
        (tmp_path / "servo.json").write_text(json.dumps({**values, **change}))
        assert taut.load_servo(tmp_path / "servo.json", voltage=7.4).notes


@pytest.mark.parametrize("change", [{"": 3}, {"": None}, {"": []}, {"actuator": HIDDEN}, {"actuator": None}])
def test_servos_of_odd_names_are_refused(change: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "servo.json").write_text(json.dumps({**SERVOS[0], **change}))
    with pytest.raises(taut.errors.ModelError):
        taut.load_servo(tmp_path / "servo.json")


# -------------------------------------------------------------------- motions


@pytest.mark.parametrize("kind", [taut.trajectories.Cubic, taut.trajectories.Quintic])
def test_motions_over_extreme_times_are_finite_or_refused(kind: Any) -> None:
    for duration in (1e300, 1e-300, 1e-320, 1e-20):
        with pytest.raises(taut.errors.RangeError):
            kind(q0=[0.0], q1=[1.0], duration=duration)
    assert np.isfinite(kind(q0=[0.0], q1=[1.0], duration=1e20).at(1.0).a).all()
    assert np.isfinite(kind(q0=[0.0], q1=[1.0], duration=1e-9).at(1e300).q).all()


@pytest.mark.parametrize("limits", [(1e-320, 1.0), (1.0, 1e-320), (1e300, 1e300), (1e-300, 1e-300)])
def test_trapezoids_of_extreme_limits_are_refused(limits: tuple[float, float]) -> None:
    with pytest.raises(taut.errors.RangeError):
        taut.trajectories.Trapezoidal(q0=[0.0], q1=[1.0], velocity=limits[0], acceleration=limits[1])
    with pytest.raises(taut.errors.RangeError):
        taut.trajectories.Line(
            T0=taut.Pose([0, 0, 0]), T1=taut.Pose([1, 0, 0]), velocity=(limits[0],) * 2, acceleration=(limits[1],) * 2
        )


@pytest.mark.parametrize(("times", "points"), [([0.0, 1e-300], [[0.0], [1.0]]), ([0.0, 1.0], [[0.0], [1e300]])])
def test_tables_without_finite_rates_are_refused(times: list[float], points: list[list[float]]) -> None:
    for make in (
        lambda: taut.trajectories.Spline(times=times, points=points),
        lambda: taut.trajectories.Samples(times=times, q=points),
    ):
        with pytest.raises(taut.errors.RangeError):
            make()


# -------------------------------------------------------------------- no file descriptors


def test_without_file_descriptors_there_is_one_sentence(tmp_path: Path) -> None:
    log = plain().save(tmp_path / "run.mcap")
    (tmp_path / "servo.json").write_text(json.dumps(SERVOS[0]))
    (tmp_path / "table.csv").write_text("t,q1\n0,1\n")
    (tmp_path / "arm.xml").write_text(MJCF)
    readers = [
        lambda: taut.load_arm(tmp_path / "arm.xml"),
        lambda: taut.load_run(log),
        lambda: taut.load_servo(tmp_path / "servo.json"),
        lambda: taut.trajectories.Samples.from_csv(tmp_path / "table.csv"),
        lambda: load_scenario("one_joint_pid"),
    ]
    for read in readers:
        read()
    arm = taut.load_arm("planar2")
    old = resource.getrlimit(resource.RLIMIT_NOFILE)
    taken: list[int] = []
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (256, old[1]))
        with suppress(OSError):
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        for read in readers:
            with pytest.raises(taut.errors.FileError):
                read()
        with pytest.warns(RuntimeWarning, match="cache"):
            ctrl = taut.compile(taut.laws.GravityPID(kp=33.0, kd=7.0, ki=0.5), arm)
    finally:
        for descriptor in taken:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, old)
    assert ctrl.step([0.0, 0.0], [0.0, 0.0], taut.JointMotion(q=[0.0, 0.0])).shape == (2,)


def test_an_exception_and_a_term_of_the_user_s_reach_no_terminal_unescaped(
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Odd(taut.Law):
        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
            return taut.Torque(**{HIDDEN: -x.v, "P": 0.0 * x.q})

    class Broken(taut.PlantBase):
        def reset(self, q: Any, v: Any, dt: float, seed: int) -> None:
            self.now = q, v

        def state(self) -> Any:
            return self.now

        def advance(self, command: Any) -> Any:
            raise OSError(HIDDEN)

    arm = taut.load_arm("planar2")
    ctrl = taut.compile(Odd(), arm)
    ctrl.explain()
    run = taut.run(ctrl, Broken(arm), duration=0.1)
    whole = taut.run(ctrl, taut.RigidPlant(arm), duration=0.2)
    mine = Check(name="mine", test=lambda run: run.finding(HIDDEN, 0, 1.0, {}), cause="{term}", remedy="none")
    shown = f"{capsys.readouterr().out}{run.outcome}{taut.doctor(run)}{taut.doctor(whole, checks=[mine])}"
    assert shown.count(printable(HIDDEN)) >= 4
    assert shown.replace("\n", "").isprintable()
