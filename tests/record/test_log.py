"""Logs: exact there and back, readable by others, and of a broken file what comes before the damage."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, SeekingReader, make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from refusals import refused

import taut
from taut.record.info import RunInfo
from taut.record.log import writing as log_module
from taut.record.log.writing import Header, open_log, sealed
from taut.record.plain import plain


def assert_same(a: taut.Run, b: taut.Run) -> None:
    """Every array bit by bit, and everything else."""
    left, right = a.arrays(), b.arrays()
    assert list(left) == list(right)
    for name in left:
        assert left[name].shape == right[name].shape, name
        assert left[name].tobytes() == right[name].tobytes(), name
    for name in ("outcome", "joint_names", "units", "continuous", "kind"):
        assert getattr(a, name) == getattr(b, name), name
    assert plain(a.info) == plain(b.info)
    assert type(a.reference) is type(b.reference)


def part(run: taut.Run, first: int, last: int) -> taut.Run:
    """Some ticks of a run."""
    cut = {name: value[first:last] for name, value in run.arrays().items()}

    def under(head: str) -> dict[str, Any]:
        return {name.partition(".")[2]: v for name, v in cut.items() if name.startswith(head)}

    return taut.Run(
        **{name: cut[name] for name in ("t", "q", "v", "tau", "command")},
        terms=under("terms."),
        extra=under("extra."),
        reference=type(run.reference).of(under("reference.")),
        **{name: getattr(run, name) for name in ("outcome", "joint_names", "units", "continuous", "kind", "info")},
    )


# -------------------------------------------------------------------- there and back


def test_a_saved_run_comes_back_bit_by_bit(noisy_run: taut.Run, tmp_path: Path) -> None:
    path = noisy_run.save(tmp_path / "run.mcap")
    assert path == tmp_path / "run.mcap"
    again = taut.load_run(path)
    assert_same(noisy_run, again)
    assert again.arm is None
    assert again.rate == 1000.0
    assert [file.name for file in tmp_path.iterdir()] == ["run.mcap"]


@pytest.mark.parametrize("kind", ["torque", "velocity", "position"])
def test_every_kind_of_command_comes_back(make_run: Any, kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    run = make_run(np.arange(5) * 0.01, rng.random((5, 2)), command=rng.random((5, 2)), kind=kind)
    assert_same(run, taut.load_run(run.save(tmp_path / "run.mcap")))


@pytest.mark.parametrize("ticks", [0, 1, 2])
def test_a_run_of_few_ticks_comes_back(noisy_run: taut.Run, ticks: int, tmp_path: Path) -> None:
    short = part(noisy_run, 0, ticks)
    again = taut.load_run(short.save(tmp_path / "run.mcap"))
    assert len(again) == ticks
    assert again.q.tobytes() == short.q.tobytes()


def test_the_log_of_a_simulation_equals_the_run(tmp_path: Path) -> None:
    arm = taut.load_arm("one_joint")
    ctrl = taut.compile(taut.laws.GravityPID(kp=2.205, kd=2.0, ki=0.1), arm, rate=700.0)
    path = tmp_path / "run.mcap"
    events = [taut.Event(t=3.0, set={"plant.payload.mass": 0.5})]
    run = taut.run(
        ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.5]), duration=7.0, log=path, events=events, progress=False
    )
    assert_same(run, taut.load_run(path))
    assert_same(run, taut.load_run(run.save(tmp_path / "again.mcap")))


def test_pieces_of_any_size_make_one_log(noisy_run: taut.Run, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    edges = [0, 0, 1, 3, 40, 41, 200, 250]
    with open_log(path) as file:
        for first, last in itertools.pairwise(edges):
            file.write(part(noisy_run, first, last))
        file.finish(noisy_run.outcome)
    assert_same(noisy_run, taut.load_run(path))


def test_a_diverged_run_keeps_its_outcome(noisy_run: taut.Run, tmp_path: Path) -> None:
    outcome = taut.Outcome(kind="diverged", message="the simulation diverged", tick=250, joint="slide")
    with open_log(tmp_path / "run.mcap") as file:
        file.write(noisy_run)
        file.finish(outcome)
    assert taut.load_run(tmp_path / "run.mcap").outcome == outcome


# -------------------------------------------------------------------- other readers


@pytest.mark.parametrize("reader", [SeekingReader, NonSeekingReader])
def test_an_independent_reader_decodes_every_number(noisy_run: taut.Run, reader: Any, tmp_path: Path) -> None:
    path = noisy_run.save(tmp_path / "run.mcap")
    seen: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        decoder = reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for _, channel, message, decoded in decoder.iter_decoded_messages():
            seen.setdefault(channel.topic, []).append(decoded)
            k = message.sequence
            assert k == len(seen["/run"]) - 1
            assert message.log_time == message.publish_time == round(noisy_run.t[k] * 1e9)

    motion: Any = noisy_run.reference
    ticks, joints = seen["/run"], ("shoulder", "slide", "gelenk")
    expected = {
        "q": noisy_run.q,
        "tau": noisy_run.tau,
        "command": noisy_run.command,
        "terms_p": noisy_run.terms["P"],
        "terms_torque_limit": noisy_run.terms["torque_limit"],
        "reference_a": motion.a,
    }
    for name, values in expected.items():
        table = [[getattr(getattr(tick, name), joint) for joint in joints] for tick in ticks]
        np.testing.assert_array_equal(table, values, err_msg=name)
    np.testing.assert_array_equal([tick.t for tick in ticks], noisy_run.t)
    np.testing.assert_array_equal([tick.extra_f_ext for tick in ticks], noisy_run.extra["F_ext"])


def test_the_summary_leads_a_reader_to_any_time_and_topic(noisy_run: taut.Run, tmp_path: Path) -> None:
    with noisy_run.save(tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 250
        assert summary.statistics.message_end_time == 249_000_000
        assert {record.name for record in reader.iter_metadata()} == {"taut.run", "taut.outcome"}
        late = list(reader.iter_messages(topics=["/run"], starting_at=240_000_000))
        assert [message.sequence for _, _, message in late] == list(range(240, 250))


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
def test_a_log_that_another_program_wrote_anew_still_loads(
    noisy_run: taut.Run, compression: CompressionType, tmp_path: Path
) -> None:
    path, other = noisy_run.save(tmp_path / "run.mcap"), tmp_path / "other.mcap"
    with path.open("rb") as file, other.open("wb") as out:
        reader = make_reader(file)
        writer = Writer(out, chunk_size=5_000, compression=compression)
        writer.start()
        summary = reader.get_summary()
        assert summary is not None
        schema = {i: writer.register_schema(s.name, s.encoding, s.data) for i, s in summary.schemas.items()}
        writer.register_channel("/foreign", "json", 0)  # so that all numbers are others
        channel = {
            i: writer.register_channel(c.topic, "cdr", schema[c.schema_id]) for i, c in summary.channels.items()
        }
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for _, c, m in reader.iter_messages():
            writer.add_message(channel[c.id], m.log_time, m.data, m.publish_time, m.sequence)
        writer.finish()
    assert_same(noisy_run, taut.load_run(other))


# -------------------------------------------------------------------- what breaks


def test_a_log_cut_anywhere_gives_the_chunks_that_are_whole(noisy_run: taut.Run, tmp_path: Path) -> None:
    whole = noisy_run.save(tmp_path / "run.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    kept = []
    first = whole.index(b"\x06", whole.index(b"taut.run"))  # the first chunk, behind the description
    cuts = [*range(8, first, 97), *range(first, len(whole), 997), len(whole) - 1]
    for length in cuts:
        cut.write_bytes(whole[:length])
        if length < first:
            with refused(taut.errors.FileError):
                taut.load_run(cut)
            kept.append(-1)
            continue
        run = taut.load_run(cut)
        kept.append(len(run))
        assert run.q.tobytes() == noisy_run.q[: len(run)].tobytes()
        if len(run) < 250:
            assert run.outcome.kind == "stopped"
            assert "without an outcome" in str(run.outcome) or "ticks are missing" in str(run.outcome)
    assert kept == sorted(kept)
    assert (kept[0], kept[-1]) == (-1, 250)
    assert len(set(kept)) > 4


def require_what_comes_before(path: Path, whole: taut.Run) -> int:
    """A damaged log is refused in one sentence, or gives its ticks up to the damage and says so; how many."""
    try:
        run = taut.load_run(path)
    except taut.errors.FileError:
        return -1
    assert run.q.tobytes() == whole.q[: len(run)].tobytes()
    assert plain(run.info) == plain(whole.info)
    if len(run) < len(whole):
        assert run.outcome.kind == "stopped"
        assert "damaged" in run.outcome.message or "without an outcome" in run.outcome.message
    return len(run)


def test_a_flipped_bit_leaves_what_comes_before(noisy_run: taut.Run, tmp_path: Path) -> None:
    whole = noisy_run.save(tmp_path / "run.mcap").read_bytes()
    broken = tmp_path / "broken.mcap"
    rng = np.random.default_rng(0)
    lengths = []
    for bit in rng.integers(0, 8 * len(whole), size=200):
        raw = bytearray(whole)
        raw[bit // 8] ^= 1 << (bit % 8)
        broken.write_bytes(raw)
        lengths.append(require_what_comes_before(broken, noisy_run))
    assert len(set(lengths)) > 4


@pytest.mark.parametrize("place", [-20, 0, 5, 100])
def test_a_damaged_description_is_read_from_the_end(noisy_run: taut.Run, place: int, tmp_path: Path) -> None:
    raw = bytearray(noisy_run.save(tmp_path / "run.mcap").read_bytes())
    raw[raw.index(b"taut.run") + place] ^= 1
    (tmp_path / "run.mcap").write_bytes(raw)
    run = taut.load_run(tmp_path / "run.mcap")
    assert len(run) == len(noisy_run)
    assert plain(run.info) == plain(noisy_run.info)


@pytest.mark.parametrize("damage", ["zeros", "noise", "gap"])
def test_a_damaged_stretch_ends_the_log(noisy_run: taut.Run, damage: str, tmp_path: Path) -> None:
    whole = noisy_run.save(tmp_path / "run.mcap").read_bytes()
    a, b = len(whole) // 2, len(whole) // 2 + 3000
    middle = {"zeros": bytes(3000), "noise": np.random.default_rng(0).bytes(3000), "gap": b""}[damage]
    path = tmp_path / "broken.mcap"
    path.write_bytes(whole[:a] + middle + whole[b:])
    assert 16 <= require_what_comes_before(path, noisy_run) < 250


def test_an_interrupted_run_leaves_a_whole_log(noisy_run: taut.Run, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"

    def interrupted() -> None:
        with open_log(path) as file:
            file.write(part(noisy_run, 0, 100))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    run = taut.load_run(path)
    assert len(run) == 100
    assert run.outcome.json() == {
        "kind": "stopped",
        "message": "the run broke off: KeyboardInterrupt",
        "tick": 99,
        "joint": None,
    }


def test_a_run_that_fails_at_once_leaves_no_file_and_keeps_an_old_one(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), open_log(path):
        raise ZeroDivisionError
    assert path.read_bytes() == b"old"


def test_a_killed_process_loses_only_what_it_had_not_handed_over(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    code = f"""
import os, signal
import numpy as np, taut
from taut.record.info import RunInfo
from taut.record.log.writing import open_log
def piece(first, last):
    t = np.arange(first, last) * 0.001
    q = np.sin(np.outer(t, [1.0, 2.0]))
    motion = taut.JointMotion.of({{"q": q, "v": q, "a": q}})
    outcome = taut.Outcome(kind="stopped", message="", tick=0)
    return taut.Run(t=t, q=q, v=q, tau=q, command=q, terms={{"P": q}}, reference=motion, outcome=outcome,
                    joint_names=("a", "b"), units=("rad", "rad"), info=RunInfo(rate=1000.0))
with open_log({str(path)!r}) as file:
    for k in range(20):
        file.write(piece(100 * k, 100 * k + 100))
    os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, timeout=60)
    assert done.returncode == -9, done.stderr
    run = taut.load_run(path)
    assert 1900 <= len(run) <= 2000  # at most a tenth of a second is lost
    np.testing.assert_array_equal(run.q, np.sin(np.outer(run.t, [1.0, 2.0])))
    assert str(run.outcome).endswith("without an outcome: its writer was stopped, or the file was cut off")


def test_a_full_disk_is_told_and_what_was_written_stays(noisy_run: taut.Run) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    with pytest.raises(taut.errors.FileError) as refused, log_module.Log(Path("/dev/full")) as file:
        file.write(noisy_run)
    assert str(refused.value) == ("log '/dev/full' cannot be written: No space left on device; choose another place")


# -------------------------------------------------------------------- messages


def test_every_wrong_file_to_read_gets_one_sentence(tmp_path: Path, noisy_run: taut.Run) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("hello, this is text")
    (tmp_path / "folder.mcap").mkdir()
    with (tmp_path / "foreign.mcap").open("wb") as out:
        writer = Writer(out)
        writer.start(library="somebody 1.0")
        writer.finish()
    for name in ("none.mcap", "empty.mcap", "text.mcap", "folder.mcap", "foreign.mcap", "nul\0.mcap"):
        with refused(taut.errors.FileError) as caught:
            taut.load_run(tmp_path / name)
        assert isinstance(caught.value, OSError)
    with refused(taut.errors.UsageError):
        taut.load_run(3)  # type: ignore[arg-type]


def test_every_wrong_place_to_write_gets_one_sentence(tmp_path: Path, noisy_run: taut.Run) -> None:
    (tmp_path / "folder.mcap").mkdir()
    for name in ("run.bag", "run", "folder.mcap", "no/run.mcap", "nul\0.mcap"):
        with refused(taut.errors.FileError):
            noisy_run.save(tmp_path / name)
        with pytest.raises(taut.errors.FileError):
            open_log(tmp_path / name)
    with refused(taut.errors.UsageError):
        noisy_run.save(None)  # type: ignore[arg-type]


def test_info_that_is_no_plain_value_is_refused_and_leaves_no_file(make_run: Any, tmp_path: Path) -> None:
    run = make_run([0.0], [[0.0]], info=RunInfo(rate=1.0, law=object()))  # type: ignore[arg-type]
    with refused(taut.errors.UsageError):
        run.save(tmp_path / "run.mcap")
    assert not list(tmp_path.iterdir())


def test_a_hostile_header_is_refused(noisy_run: taut.Run, tmp_path: Path) -> None:
    good = plain(Header.of(noisy_run))
    bad: list[dict[str, Any]] = [
        good | {"format": 1},
        good | {"extra": {"x": [10**12]}},
        good | {"extra": {"x": [-1]}},
        good | {"joint_names": []},
        good | {"joint_names": ["a", "a", "b"]},
        good | {"units": ["rad"]},
        good | {"units": ["rad", "m", "deg"]},
        good | {"continuous": [7]},
        good | {"kind": "mood"},
        good | {"reference": "Unheard"},
        good | {"fields": {"q": [2]}},
        {name: value for name, value in good.items() if name != "terms"},
    ]
    for values in bad:
        path = tmp_path / "bad.mcap"
        with path.open("wb") as out:
            writer = Writer(out)
            writer.start()
            writer.add_metadata("taut.run", sealed(json.dumps(values)))
            writer.finish()
        with refused(taut.errors.FileError):
            taut.load_run(path)


def test_a_closed_log_takes_no_more_ticks(noisy_run: taut.Run, tmp_path: Path) -> None:
    with open_log(tmp_path / "run.mcap") as file:
        file.write(noisy_run)
        file.finish(noisy_run.outcome)
        with refused(taut.errors.FileError):
            file.write(noisy_run)
    assert_same(noisy_run, taut.load_run(tmp_path / "run.mcap"))
