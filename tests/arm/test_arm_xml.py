"""The XML reader: what it gives, and that it stops at its bounds. Counts are compared, never the clock."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
from refusals import refused

from taut.arm.load import load_arm
from taut.arm.loaders import xml
from taut.arm.loaders.mjcf_source import MOST
from taut.arm.loaders.xml import BadNumberError, Element, numbers, parse_xml, read_xml
from taut.arm.rules import MAX_LINKS
from taut.base.errors import FileError, ModelError

MEGABYTE = 2**20


def refusal(data: bytes) -> str:
    with pytest.raises(ModelError) as caught:
        parse_xml(data, "robot.urdf")
    return str(caught.value)


def test_elements_have_attributes_children_text_and_lines() -> None:
    root = parse_xml(b'<a x="1">\n  <b/>\n  <b y="2">words</b>\n</a>', "a.xml")
    assert (root.tag, root.get("x"), root.get("z"), root.line) == ("a", "1", None, 1)
    first, second = root.all("b")
    assert (first.line, second.line) == (2, 3)
    assert second.text == ["words"]
    assert [element.tag for element in root.walk()] == ["a", "b", "b"]


def test_comments_instructions_and_other_encodings_are_fine() -> None:
    latin = b'<?xml version="1.0" encoding="iso-8859-1"?><!-- hi --><?style x?><a b="\xe9"/>'
    assert parse_xml(latin, "a").get("b") == "é"
    assert parse_xml('<?xml version="1.0" encoding="utf-16"?><a b="é"/>'.encode("utf-16"), "a").get("b") == "é"
    assert parse_xml(b"\xef\xbb\xbf<a/>", "a").tag == "a"


def test_a_file_too_deep_is_refused_at_the_bound_and_not_read_further() -> None:
    assert (
        refusal(b"<link>" * 20_000)
        == "robot.urdf: its elements are more than 200 deep, the most that is read (line 1)"
    )
    lines = b"<link>\n" * 20_000
    with pytest.raises(ModelError) as caught:
        parse_xml(lines, "robot.urdf")
    assert caught.value.problems[0].line == xml.MAX_ELEMENT_DEPTH + 1


def test_a_file_with_too_many_elements_is_refused_at_the_bound() -> None:
    with pytest.raises(ModelError) as caught:
        parse_xml(b"<robot>\n" + b"<link/>\n" * 200_000, "robot.urdf")
    assert caught.value.problems[0].line == xml.MAX_ELEMENTS + 1
    assert caught.value.problems[0].message == "it has more than 20000 elements, the most that is read"


def test_a_file_too_large_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    file = tmp_path / "big.urdf"
    with file.open("wb") as stream:
        stream.write(b"<robot>")
        stream.truncate(xml.MAX_BYTES + 10)
    with refused(ModelError):
        read_xml(file)


def test_an_entity_bomb_is_refused_before_it_expands() -> None:
    bomb = b'<!DOCTYPE lolz [<!ENTITY a0 "ha">' + b"".join(
        b'<!ENTITY a%d "%s">' % (i, b"&a%d;" % (i - 1) * 10) for i in range(1, 20)
    )
    tracemalloc.start()
    text = refusal(bomb + b"]><robot>&a19;</robot>")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "it has a DOCTYPE, which can declare entities; a robot model needs none: delete it" in text
    assert peak < MEGABYTE


def test_an_external_entity_is_never_read(tmp_path: Path) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_text("do not read me")
    text = refusal(f'<!DOCTYPE r [<!ENTITY s SYSTEM "{secret.as_uri()}">]><robot name="&s;"/>'.encode())
    assert "DOCTYPE" in text
    assert "do not read me" not in text


def test_a_model_with_five_thousand_links_is_refused_by_count(tmp_path: Path) -> None:
    links = "".join(f'<link name="l{i}"/>' for i in range(5000))
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>' for i in range(4999)
    )
    file = tmp_path / "long.urdf"
    file.write_text(f'<robot name="long">{links}{joints}</robot>')
    with pytest.raises(ModelError) as caught:
        load_arm(file)
    assert caught.value.problems[0].message == f"the model has 5000 links; an arm has {MAX_LINKS} at most"
    assert len(caught.value.problems) == 1  # none of them was read


def test_an_mjcf_with_too_many_of_anything_never_reaches_mujoco(tmp_path: Path) -> None:
    file = tmp_path / "long.xml"
    for tag, most in MOST.items():
        count = most + 1
        file.write_text(f"<mujoco><worldbody>{f'<{tag}/>' * count}</worldbody></mujoco>")
        with pytest.raises(ModelError) as caught:
            load_arm(file)
        assert caught.value.problems[0].message == f"the model has {count} <{tag}> elements; {most} at most are read"


def test_a_chain_of_a_thousand_fixed_links_is_read(tmp_path: Path) -> None:
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="l{i}">{inertial}</link>' for i in range(MAX_LINKS))
    joints = "".join(
        f'<joint name="j{i}" type="{"fixed" if i else "continuous"}">'
        f'<parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(MAX_LINKS - 1)
    )
    file = tmp_path / "chain.urdf"
    file.write_text(f'<robot name="chain">{links}{joints}</robot>')
    arm = load_arm(file)
    assert arm.bodies[0].mass == pytest.approx(MAX_LINKS - 1)


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("1 2", 3),
        ("", 1),
        ("1_000", 1),
        ("0x10", 1),
        ("1,5", 1),
        ("١٢", 1),
        ("nan", 1),
        ("1 -Infinity 2", 3),
        ("nan(ind)", 1),
        ("1e400", 1),
        ("2e9", 1),
        ("1 " * 6000, None),
        ("x" * 100, 1),
    ],
    ids=range(13),
)
def test_what_is_no_number_is_refused_in_words(text: str, count: int | None) -> None:
    with refused(BadNumberError):
        numbers(text, count)


def test_numbers_are_read_as_python_reads_them() -> None:
    assert numbers(" 1 -2.5e-3\t.5\n+7. 1E2 ") == (1.0, -2.5e-3, 0.5, 7.0, 100.0)
    assert numbers("1e16", 1, bounded=False) == (1e16,)


@pytest.mark.parametrize("content", [b"", b"<a/>"])
def test_empty_files_and_folders_are_file_errors(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "m.urdf"
    file.write_bytes(content)
    if not content:
        with refused(FileError):
            read_xml(file)
    with refused(FileError):
        read_xml(tmp_path)


def test_an_element_does_not_hold_what_it_was_not_given() -> None:
    element = Element("a", {}, 1, "f")
    assert element.all("b") == []


@pytest.mark.bars
def test_hostile_files_are_refused_quickly(tmp_path: Path, bar: Callable[[str, object], None]) -> None:
    """What they cost is counted in a process of its own, whose peak of memory is its own."""
    entities = ['<!ENTITY b0 "ha">', *(f'<!ENTITY b{i} "{f"&b{i - 1};" * 10}">' for i in range(1, 10))]
    bomb = f"<!DOCTYPE r [{''.join(entities)}]><robot>&b9;</robot>"
    links = "".join(f'<link name="l{i}"/>' for i in range(5000))
    files = {
        "bomb.urdf": bomb,
        "bomb.xml": bomb.replace("robot", "mujoco"),
        "deep.urdf": "<robot>" + "<link>" * 20_000,
        "deep.xml": "<mujoco><worldbody>" + "<body>" * 20_000,
        "links.urdf": f'<robot name="r">{links}</robot>',
        "replicate.xml": '<mujoco><worldbody><replicate count="100000000"><body><geom size="1"/></body></replicate>'
        "</worldbody></mujoco>",
        "replicates.xml": "<mujoco><worldbody>" + '<replicate count="1000">' * 5 + "<body/>" + "</replicate>" * 5
        + "</worldbody></mujoco>",
        "include.xml": '<mujoco><include file="include.xml"/></mujoco>',
    }  # fmt: skip
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    code = """if True:
        import sys, time, taut
        for name in sys.argv[1:]:
            start = time.perf_counter()
            try:
                taut.load_arm(name)
            except taut.TautError:
                peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
                print(time.perf_counter() - start, int(peak.split()[1]) / 1024)
    """
    done = subprocess.run(
        [sys.executable, "-c", code, *files], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    costs = [[float(x) for x in line.split()] for line in done.stdout.splitlines()]
    seconds, megabytes = max(s for s, _ in costs), costs[-1][1]
    bar("row 22: entity bombs, depth, counts: refused, slowest [s], peak [MB]",
        f"{len(costs)} of {len(files)}, {seconds:.2f}, {megabytes:.0f}")  # fmt: skip
    assert len(costs) == len(files)
    assert seconds < 2.0
    assert megabytes < 200.0
