"""Reports: valid HTML with everything in it, nothing asked of other places, no folders, and lines that repeat a run."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import math
import re
import shutil
from pathlib import Path

import html5lib
import matplotlib.figure
import matplotlib.image
import numpy as np
import pytest
from refusals import refused

import taut
from taut.analysis import Content, Result, Table
from taut.base.errors import FileError, UsageError
from taut.cli.main import main
from taut.record.report import html_of, without_folders

HTML = "{http://www.w3.org/1999/xhtml}"
MOST_BYTES = 3_000_000


@pytest.fixture(scope="module")
def run() -> taut.Run:
    arm = taut.load_arm("planar2")
    law = taut.laws.FeedForward() + taut.laws.PID(kp=[80.0, 60.0], kd=[8.0, 6.0])
    ctrl = taut.compile(law, arm, limits=taut.Limits(tau=[30.0, 10.0]))
    ref = taut.trajectories.Sine(center=[0.3, 0.5], amplitude=[0.3, 0.2], frequency=[0.8, 1.1], phase=[0.0, 1.0])
    loop = taut.Loop(ctrl, taut.RigidPlant(arm), ref, duration=0.4)
    loop.parameters["plant.payload.mass"] = 0.7
    return taut.run(loop, q0=[0.2, 0.4], seed=5)


def tree(text: str) -> list:
    """Every element; the strict parser raises at the first thing that is no HTML."""
    parser = html5lib.HTMLParser(strict=True)
    return list(parser.parse(text).iter())


def words_of(text: str) -> str:
    return " ".join(" ".join(x for x in element.itertext()) for element in tree(text) if element.tag == HTML + "body")


def check_alone(text: str) -> None:
    """Valid, small, without scripts, and everything that it points to is in it."""
    elements = tree(text)
    assert len(text.encode()) < MOST_BYTES
    tags = {element.tag.removeprefix(HTML) for element in elements if isinstance(element.tag, str)}
    assert not tags & {"script", "link", "iframe", "object", "embed", "base", "form", "a", "video", "audio"}
    for element in elements:
        for name, value in element.attrib.items():
            assert not name.startswith("on"), name
            if name in ("src", "href", "srcset", "style", "background", "poster"):
                assert value.startswith("data:image/png;base64,"), value[:60]
    style = "".join(element.text or "" for element in elements if element.tag == HTML + "style")
    assert not re.search(r"url\(|@import|https?:", style)
    assert not re.search(r"https?://", text)
    policy = [e.attrib["content"] for e in elements if e.attrib.get("http-equiv") == "Content-Security-Policy"]
    assert policy == ["default-src 'none'; img-src data:; style-src 'unsafe-inline'"]


def pictures(text: str) -> list[np.ndarray]:
    found = [e for e in tree(text) if e.tag == HTML + "img"]
    assert all(e.attrib["alt"] for e in found)
    return [matplotlib.image.imread(io.BytesIO(base64.b64decode(e.attrib["src"].partition(",")[2]))) for e in found]


def test_the_report_of_a_run_has_its_figures_picture_settings_versions(run: taut.Run, tmp_path: Path) -> None:
    file = taut.report(run, tmp_path / "run.html")
    text = file.read_text(encoding="utf-8")
    check_alone(text)
    words = words_of(text)
    rows = {
        tuple(cell.text for cell in row)
        for row in (list(element) for element in tree(text) if element.tag == HTML + "tr")
    }
    first = next(element for element in tree(text) if element.tag == HTML + "tbody")
    figures = {row[0].text: [cell.text for cell in row[1:3]] for row in first}
    for name, number in (("RMS error", run.metrics.overall("rms_error")), ("effort", run.metrics.overall("effort"))):
        assert float(figures[name][0]) == pytest.approx(number, rel=1e-3)
    assert figures["effort"][1] == "(N m)^2 s"
    assert ("plant.payload.mass", "0.7") in rows
    assert ("seed", "5") in rows
    assert ("limits of the controller", "tau = [30.0, 10.0]") in rows
    assert ("sensing", "Sensing()") in rows
    assert ("taut", taut.__version__) in rows
    assert {"numpy", "llvmlite", "mujoco", "Python", "platform"} <= {row[0] for row in rows}
    assert "Integral of tau^2, as in figure 10.12; for all joints the sum" in words
    assert len(pictures(text)) == 1
    assert pictures(text)[0].std() > 0.05  # something is drawn


def test_the_report_of_a_run_from_python_lists_what_a_repeat_needs(tmp_path: Path) -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(taut.laws.PID(kp=80.0, kd=8.0), arm)
    heavy = taut.RigidPlant(arm.with_gears(50.0, 1e-4).with_payload(1.0), friction=None)
    made = taut.run(ctrl, heavy, taut.hold(), duration=0.05)
    words = words_of(taut.report(made, tmp_path / "run.html").read_text(encoding="utf-8"))
    assert "the plant RigidPlant(planar2), with its friction, drives, sensors, contacts and scene" in words
    assert "the arm of the plant, which is in the log and differs in joints, payload" in words
    assert "taut run" not in words


def test_a_title_ends_with_a_clause_and_not_within_a_word() -> None:
    d = taut.error_dynamics(M=0.5, b=0.1, kp=2.205, kd=2.0)
    ctrl = taut.compile(taut.laws.GravityPID(kp=60.0, kd=9.0), taut.load_arm("planar2"))
    made = taut.run(ctrl, taut.RigidPlant(taut.load_arm("planar2")), taut.JointMotion(q=[0.3, 0.8]), duration=0.1)
    title = taut.analysis.lyapunov(made).content().title
    assert title.startswith("Lyapunov function")
    assert d.content().title.lower() == "linear system of 2 states in continuous time"


def test_a_run_of_a_scenario_is_repeated_by_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    place = tmp_path / "samples.csv"
    place.write_text("t,q1\n0,0\n0.05,0.1\n0.2,0.1\n")
    text = (
        '[arm]\nmodel = "one_joint"\n[laws.PD]\nlaw = "PID"\nkp = 2\nkd = 2\n[plant]\n[reference]\nkind = "samples"\n'
    )
    text += f'file = "{place}"\n[run]\nduration = 0.1\n[outputs]\nlog = "mine.mcap"\n'
    (tmp_path / "mine.toml").write_text(text)
    assert main(["run", "mine.toml", "--out", "."]) == 0
    assert main(["report", "mine.mcap", "--out", "mine.html"]) == 0
    assert capsys.readouterr().out.endswith("law PID(kp=2.0, kd=2.0), arm one_joint\nreport   mine.html\n")
    made = (tmp_path / "mine.html").read_text(encoding="utf-8")
    check_alone(made)
    assert "taut run mine.toml" in made
    assert "<h1>mine: PD</h1>" in made
    assert "file = &quot;samples.csv&quot;" in made
    assert str(tmp_path) not in made
    assert main(["report", "mine.mcap", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["report"] == "report.html"


def test_comparisons_and_grades_have_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    plain = ["--model", "mass=0.1", "trials=1", "--report", "table.html"]
    assert main(["compare", "feedforward_error", "--laws", "feedback", "feedforward", "--by", "effort", *plain]) == 0
    text = (tmp_path / "table.html").read_text(encoding="utf-8")
    check_alone(text)
    assert "taut compare feedforward_error --laws feedback feedforward --by effort" in text
    assert "theta(t) = pi/2 - cos(t)" in text  # the scenario's own words
    assert len(pictures(text)) == 1
    words = [
        "compare",
        "feedforward_error",
        "--laws",
        "feedforward",
        "--reference",
        "feedback",
        "--report",
        "grade.html",
    ]
    assert main(words) == 1
    text = (tmp_path / "grade.html").read_text(encoding="utf-8")
    check_alone(text)
    assert "failed, with a tolerance of 5 %" in words_of(text)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Gains(Result):
    """A result of a user's own analysis."""

    kp: float

    def content(self) -> Content:
        return Content(
            title="<gains>",
            summary=[f"kp = {self.kp:g} & kd < 20"],
            tables=[Table(title="gains", columns=("gain", "value"), rows=[("kp", self.kp), ("kd", math.nan)])],
            figures={"step": self._step},
            repeat="taut design ...",
        )

    def _step(self) -> matplotlib.figure.Figure:
        figure = matplotlib.figure.Figure()
        figure.subplots().plot([0.0, self.kp])
        return figure


def test_a_result_of_a_user_has_text_json_figure_and_report(tmp_path: Path) -> None:
    made = Gains(kp=100.0)
    text = taut.report(made, tmp_path / "d.html").read_text(encoding="utf-8")
    check_alone(text)
    assert "<h1>&lt;gains&gt;</h1>" in text
    assert "kp = 100 &amp; kd &lt; 20" in text
    assert "taut design ..." in text
    rows = {tuple(cell.text for cell in e) for e in tree(text) if e.tag == HTML + "tr"}
    assert {("kp", "100"), ("kd", "-")} <= rows
    assert len(pictures(text)) == 1
    assert str(made).splitlines()[-1].split() == ["kd", "-"]
    assert json.loads(json.dumps(made.json()))["tables"]["gains"][0] == {"gain": "kp", "value": 100.0}
    assert made.plot().axes[0].lines[0].get_ydata()[1] == made.kp
    assert "<h1>other</h1>" in taut.report(made, tmp_path / "d.html", title="other").read_text(encoding="utf-8")


def test_a_linear_loop_has_a_report(tmp_path: Path) -> None:
    arm = taut.load_arm("one_joint")
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    lin = taut.linearise(taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0), at=arm.home)
    text = taut.report(lin, tmp_path / "lin.html").read_text(encoding="utf-8")
    check_alone(text)
    rows = {tuple(cell.text for cell in e) for e in tree(text) if e.tag == HTML + "tr"}
    assert {row[0].partition(".")[0] for row in rows} >= {"-9", "-11"}  # the poles of the loop as it is sampled
    assert "stable: the slowest mode decays with 9.09 1/s" in words_of(text)
    assert len(pictures(text)) >= 1


def test_a_report_fits_a_phone_and_asks_nothing_of_the_network(run: taut.Run, tmp_path: Path) -> None:
    """In a real browser, where there is one: no wider than the screen, and no request but for the file."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    sync_api = pytest.importorskip("playwright.sync_api")
    if chromium is None:
        pytest.skip("no browser is installed")
    file = taut.report(run, tmp_path / "run.html")
    with sync_api.sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-background-networking", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 390, "height": 844})
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(file.as_uri())
        wider = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        cut = page.evaluate("(e => e.scrollWidth - e.clientWidth)(document.querySelector('pre.again'))")
        browser.close()
    assert (wider, cut) == (0, 0)
    assert [url for url in asked if not url.startswith("data:")] == [file.as_uri()]


def test_whatever_stands_in_a_text_stays_a_text() -> None:
    nasty = "a</pre><script>alert(1)</script>&amp;\"'\x00\x1b[31m\ud800 /home/x/y.py"
    page = Content(
        title=nasty,
        summary=[nasty],
        faults=[nasty],
        tables=[Table(title=nasty, columns=[nasty, nasty], rows=[[nasty, nasty]], note=nasty)],
        settings={nasty: nasty},
        texts={nasty: nasty},
        repeat=nasty,
    )
    text = html_of(page).encode("utf-8", "replace").decode()
    check_alone(text)
    assert "/home/x" not in text
    assert words_of(text).count("<script>alert(1)</script>&amp;") == 14


def test_folders_of_files_are_left_out_and_units_are_not() -> None:
    for given, kept in {
        "see /home/anna/run.mcap:3": "see run.mcap:3",
        "'/a/b c'": "'b c'",
        r"C:\Users\anna\law.py": "law.py",
        "~/work/law.py": "law.py",
        "N m/rad and rad/s/s and 1/2/3": "N m/rad and rad/s/s and 1/2/3",
        "a / b / c": "a / b / c",
        "relative/path.toml": "relative/path.toml",
        "file:///home/anna/x.html": "x.html",
    }.items():
        assert without_folders(given) == kept


# -------------------------------------------------------------------- what goes wrong


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_run_that_ended_in_a_fault_says_so_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(taut.laws.PID(kp=1e9, kd=1e7), arm)
    bad = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[1.0, 1.0]), duration=1.0)
    bad.save("bad.mcap")
    assert main(["report", "bad.mcap"]) == 2
    told = capsys.readouterr()
    assert told.out.endswith("\nreport   report.html\n")
    assert "'bad.mcap' is no whole run, and the report is of what there is: the simulation diverged" in told.err
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    check_alone(text)
    assert text.index("<b>Fault:</b> the simulation diverged") < text.index("<h2>")


def test_gaps_are_told(run: taut.Run) -> None:
    kept = np.delete(np.arange(len(run)), range(100, 120))
    fields = {name: getattr(run, name)[kept] for name in ("t", "q", "v", "tau", "command")}
    terms = {name: values[kept] for name, values in run.terms.items()}
    wanted = taut.JointMotion.of({name: getattr(run.reference, name)[kept] for name in "qva"})
    holey = dataclasses.replace(run, **fields, terms=terms, reference=wanted)
    assert holey.content().faults[0].startswith("The run has a gap, from t = 0.099 to 0.12 s")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["no.mcap"], "log 'no.mcap' does not exist"),
        (
            ["run.mcap", "--out", "no/report.html"],
            "report 'no/report.html' needs the folder 'no', which does not exist; create it first",
        ),
        (["run.mcap", "--out", "report.pdf"], "the report's name must end in .html or .htm; got 'report.pdf'"),
        (["short.mcap"], "a report needs a run of 2 ticks at least; got 1"),
        (["text.mcap"], "is no MCAP file"),
    ],
)
def test_a_wrong_request_is_one_sentence_and_nothing_is_lost(
    words: list[str],
    message: str,
    run: taut.Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    run.save("run.mcap")
    run.between(0.0, 0.0005).save("short.mcap")
    (tmp_path / "text.mcap").write_text("hello")
    (tmp_path / "report.html").write_text("what was there")
    before = sorted(tmp_path.iterdir())
    assert main(["report", *words]) == 2
    told = capsys.readouterr()
    assert (told.out, told.err.count("\n")) == ("", 1)
    assert message in told.err
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "report.html").read_text() == "what was there"


def test_long_names_in_heads_may_break_and_one_joint_is_one(run: taut.Run) -> None:
    head = Table(columns=("figure", "panda_joint7"), rows=[("a_b", "1")])
    text = html_of(Content(title="t", tables=(head,)))
    assert "panda_<wbr>joint7</th>" in text
    assert "a_b</td>" in text
    arm = taut.load_arm("one_joint")
    ctrl = taut.compile(taut.laws.PID(kp=1.0), arm)
    assert ", 1 joint. " in taut.run(ctrl, taut.RigidPlant(arm), duration=0.01).content().summary[0]
    assert f", {run.n} joints. " in run.content().summary[0]


def test_what_prints_has_a_report_whose_title_says_what_it_is(run: taut.Run, tmp_path: Path) -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(taut.laws.GravityPID(kp=50.0, kd=10.0), arm)
    loop = taut.Loop(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.3, 0.8]), duration=0.1)
    d = taut.error_dynamics(M=0.5, b=0.1, kp=2.205, kd=2.0)
    found = taut.analysis.stability_map(
        lambda kp, kd: taut.error_dynamics(M=0.5, kp=kp, kd=kd, rate=100.0),
        [1.0, 2.0],
        [1.0, 400.0],
        labels=("kp [N m/rad]", "kd [N m s/rad]"),
    )
    told = taut.doctor(taut.run(taut.Loop(ctrl, taut.RigidPlant(arm.with_payload(1.0)), loop.ref, duration=1.0)))
    for made, title, words in (
        (
            taut.analysis.coupling(loop, at=[0.3, 0.8]),
            "coupling of the joints",
            "coupling of the inertia matrix",
        ),
        (told, f"Diagnosis: {told.findings[0].name}", "remedy"),
        (found, "Stability map of kp", "stability boundary"),
        (d, "Linear system of 2 states", "settling time"),
        (
            taut.analysis.tool_impedance(loop, at=[0.3, 0.8], direction=[1.0, 0.0, 0.0]),
            "tool impedance",
            "|Z| [",
        ),
    ):
        text = taut.report(made, tmp_path / "x.html").read_text(encoding="utf-8")
        check_alone(text)
        (heading,) = [e for e in tree(text) if e.tag == HTML + "h1"]
        assert (heading.text or "").lower().startswith(title.lower())
        assert words in text
    assert "<figcaption>" in taut.report(told, tmp_path / "x.html").read_text(encoding="utf-8")


def test_what_has_no_report_is_told(run: taut.Run, tmp_path: Path) -> None:
    for x in (3.0, taut.Run, None):
        with refused(UsageError):
            taut.report(x, tmp_path / "x.html")
    (tmp_path / "y.html").mkdir()
    with refused(FileError):
        taut.report(run, tmp_path / "y.html")
    assert [path.name for path in tmp_path.iterdir()] == ["y.html"]
