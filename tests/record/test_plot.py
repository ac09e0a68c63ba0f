"""Plots: the right numbers, readable letters, no window."""

from __future__ import annotations

import dataclasses
import itertools
import subprocess
import sys
from io import BytesIO
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from refusals import refused

import taut
from taut.base.plot_style import thinned
from taut.record.comparison_plot import compare
from taut.record.info import RunInfo


def axes_titled(figure: Figure, title: str) -> Any:
    """The axes with a title."""
    found = [ax for ax in figure.findobj(matplotlib.axes.Axes) if ax.get_title(loc="left").startswith(title)]
    assert found, f"no axes '{title}'"
    return found[0]


def curves(ax: Any, style: str) -> list[np.ndarray[Any, Any]]:
    return [line.get_ydata() for line in ax.lines if line.get_linestyle() == style and len(line.get_ydata()) > 2]


def assert_legible(figure: Figure) -> None:
    """Every text stands inside the figure, and none on another one."""
    FigureCanvasAgg(figure).draw()
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    axes = [ax for ax in figure.findobj(matplotlib.axes.Axes) if ax.get_visible()]
    ticks = [label for ax in axes for label in (*ax.get_xticklabels(), *ax.get_yticklabels())]
    others = [text for legend in figure.findobj(matplotlib.legend.Legend) for text in legend.get_texts()]
    for ax in axes:
        others += [ax.title, ax._left_title, ax.xaxis.label, ax.yaxis.label, *ax.texts]
    boxes = []
    for text in others:
        if not text.get_text().strip():
            continue
        box = text.get_window_extent(renderer)
        assert text.get_fontsize() >= 7.5, text
        assert figure.bbox.padded(3.0).fully_containsx(box.x0), text
        assert figure.bbox.padded(3.0).fully_containsx(box.x1), text
        assert figure.bbox.padded(3.0).fully_containsy(box.y0), text
        assert figure.bbox.padded(3.0).fully_containsy(box.y1), text
        boxes.append((text, box.shrunk(0.9, 0.6)))
    assert all(label.get_fontsize() >= 7.5 for label in ticks)
    for i, (text, box) in enumerate(boxes):
        for other, its in boxes[i + 1 :]:
            assert not box.overlaps(its), (text, other)


@pytest.fixture
def many(make_run: Any) -> Any:
    """Runs of n joints that move, with long names."""

    def make(n: int, **others: Any) -> taut.Run:
        t = np.arange(400) * 0.005
        rng = np.random.default_rng(n)
        wanted = np.sin(np.outer(t, rng.uniform(1.0, 4.0, n)))
        q = wanted + 0.01 * np.outer(t, np.arange(n))
        parts = {"P": 20.0 * (wanted - q), "I": np.zeros_like(q), "gravity": 5.0 * q}
        values = {
            "q_ref": wanted,
            "tau": parts["P"] + parts["gravity"],
            "terms": parts,
            "joint_names": tuple(f"a_rather_long_joint_name_{i}" for i in range(n)),
            "info": RunInfo(rate=200.0, law=f"GravityPID(kp={[1.0 / 3.0] * n}, kd=2.0)", arm="a", plant="plant"),
        }
        return make_run(t, q, **(values | others))

    return make


# -------------------------------------------------------------------- one run


def test_the_plot_shows_the_numbers_of_the_run(panda_run: taut.Run) -> None:
    figure = panda_run.plot()
    position, error, torque = (axes_titled(figure, t) for t in ("position", "tracking error", "torque"))
    np.testing.assert_array_equal(np.column_stack(curves(position, "-")), panda_run.q)
    wanted: Any = panda_run.reference
    np.testing.assert_array_equal(np.column_stack(curves(position, "--")), wanted.q)
    np.testing.assert_array_equal(np.column_stack(curves(error, "-")), panda_run.error)
    np.testing.assert_array_equal(np.column_stack(curves(torque, "-")), panda_run.tau)
    assert position.get_ylabel() == "q [rad]"
    assert torque.get_ylabel() == "tau [N m]"
    assert torque.get_xlabel() == "t [s]"
    terms = axes_titled(figure, "panda_joint4")
    busy = [name for name in panda_run.terms if panda_run.terms[name].any()]
    np.testing.assert_array_equal(
        np.column_stack(curves(terms, "-")), np.column_stack([panda_run.terms[name][:, 3] for name in busy])
    )
    assert set(panda_run.terms) - set(busy) == {"I", "torque_limit"}
    labels = [text.get_text() for text in figure.findobj(Text)]
    assert "zero: I, torque_limit" in labels
    title = figure.get_suptitle()
    assert title.startswith("ComputedTorque(kp=100, kd=20)  on  RigidPlant(panda)\ncompleted: 501 ticks")


@pytest.mark.part(1)
@pytest.mark.parametrize("n", [1, 2, 7, 30])
def test_a_plot_is_legible_for_any_number_of_joints(many: Any, n: int) -> None:
    figure = many(n).plot()
    assert figure.get_figwidth() == 7.5
    assert_legible(figure)


def test_joints_in_rad_and_in_m_have_axes_of_their_own(many: Any) -> None:
    figure = many(3, units=("m", "rad", "m")).plot()
    assert_legible(figure)
    labels = [ax.get_ylabel() for ax in figure.findobj(matplotlib.axes.Axes)]
    assert labels[:6] == ["q [m]", "wanted - true [m]", "tau [N]", "q [rad]", "wanted - true [rad]", "tau [N m]"]
    assert axes_titled(figure, "force").get_ylabel() == "tau [N]"


def test_of_many_joints_those_with_the_largest_error_are_shown(many: Any) -> None:
    run = many(30)
    figure = run.plot()
    shown = curves(axes_titled(figure, "tracking error"), "-")
    np.testing.assert_array_equal(np.column_stack(shown), run.error[:, 22:])
    assert "8 of 30 joints" in figure.get_suptitle()


def test_chosen_joints_are_shown_by_name(many: Any) -> None:
    run = many(30)
    figure = run.plot(joints=["a_rather_long_joint_name_3", "a_rather_long_joint_name_12"])
    np.testing.assert_array_equal(np.column_stack(curves(axes_titled(figure, "position"), "-")), run.q[:, [3, 12]])
    one = run.plot(joints="a_rather_long_joint_name_3")
    np.testing.assert_array_equal(curves(axes_titled(one, "position"), "-")[0], run.q[:, 3])


def test_a_limit_is_drawn_where_the_torque_comes_near_it(many: Any) -> None:
    info = RunInfo(rate=1.0, law="PID()", parameters={"limits.tau": np.array([6.0, 1000.0])})
    figure = many(2, info=info).plot()
    levels = {
        float(line.get_ydata()[0]) for line in axes_titled(figure, "torque").lines if line.get_label() == "limit"
    }
    assert levels == {-6.0, 6.0}
    info = dataclasses.replace(info, parameters={"limits.tau": np.array(1000.0)})
    assert not [one for one in axes_titled(many(2, info=info).plot(), "torque").lines if one.get_label() == "limit"]


def test_a_velocity_command_is_plotted_as_one(many: Any) -> None:
    figure = many(2, kind="velocity").plot()
    assert axes_titled(figure, "velocity command").get_ylabel() == "command [rad/s]"


@pytest.mark.long
def test_figures_can_be_saved_in_any_format_without_a_warning(panda_run: taut.Run) -> None:
    figure = panda_run.plot(joints=["panda_joint1", "panda_joint4"])
    for kind in ("png", "pdf", "svg"):
        out = BytesIO()
        figure.savefig(out, format=kind)
        assert out.tell() > 10_000


def test_a_run_that_diverged_can_be_plotted(many: Any) -> None:
    run = many(2)
    run.q[-3:] = [[1e12, 1.0], [1e150, 1e200], [np.inf, np.nan]]
    run.plot().savefig(BytesIO(), format="png")


def test_plotting_leaves_pyplot_and_the_global_settings_alone() -> None:
    code = """
import sys, numpy as np, matplotlib, taut
from taut.record.info import RunInfo
settings = lambda: {name: matplotlib.rcParams[name] for name in matplotlib.rcParams if name != "backend"}
before = settings()
t = np.arange(50) * 0.01
q = np.sin(t)[:, None]
run = taut.Run(t=t, q=q, v=q, tau=q, command=q, terms={"P": q}, reference=taut.JointMotion.of({"q": q, "v": q, "a": q}),
    outcome=taut.Outcome(kind="completed", message="", tick=49), joint_names=("a",), units=("rad",), info=RunInfo(rate=100.0))
run.plot().savefig(sys.stdout.buffer, format="png")
assert "matplotlib.pyplot" not in sys.modules
assert settings() == before
"""
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr.decode()
    assert done.stdout.startswith(b"\x89PNG")


def test_importing_a_run_does_not_import_matplotlib() -> None:
    code = (
        "import sys, taut; taut.Run; taut.load_run; assert not {'matplotlib', 'mujoco', 'pandas'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_a_long_curve_keeps_its_ends_and_extremes_when_it_is_thinned() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(100_003) * 0.001
    y = rng.standard_normal(len(t))
    y[54_321] = 99.0
    few_t, few_y = thinned(t, y)
    assert len(few_t) < 4_300
    assert (np.diff(few_t) >= 0.0).all()
    assert (few_t[0], few_t[-1]) == (t[0], t[-1])
    assert (few_y.min(), few_y.max()) == (y.min(), y.max())
    short = thinned(t[:3000], y[:3000])
    assert len(short[0]) == 3000


def test_wrong_joints_get_one_sentence(many: Any, make_run: Any) -> None:
    run = many(3)
    for joints in (["a_rather_long_joint_nam"], []):
        with refused(taut.TautError):
            run.plot(joints=joints)
    with refused(taut.errors.UsageError):
        make_run([], np.zeros((0, 1))).plot()


def test_terms_beyond_the_eight_colours_are_told_apart_by_their_dashes_and_leave_room(many: Any) -> None:
    q = many(7).q
    terms = {f"a_term_{i}": q + 0.1 * i for i in range(15)} | {f"an_idle_one_of_long_name_{i}": 0.0 * q for i in "ab"}
    figure = many(7, terms=terms).plot()
    assert_legible(figure)
    ax = figure.axes[3]
    looks = {(line.get_color(), str(line.get_linestyle())) for line in ax.lines}
    assert len(looks) == len(ax.lines) == 15
    assert min(ax.get_position().height for ax in figure.axes if ax.get_visible()) * figure.get_figheight() > 0.5


def test_a_plot_of_phases_has_their_names_and_what_each_asked_for(pressing_task: taut.Run) -> None:
    run = pressing_task
    figure = run.plot()
    assert_legible(figure)
    assert figure.get_suptitle().startswith("approach, press  on  MujocoPlant(ur5)")
    tool, normal = axes_titled(figure, "tool and reference"), axes_titled(figure, "force along the normal")
    assert [text.get_text() for text in tool.texts] == ["approach", "press"]
    highest = tool.transData.transform((0.0, max(np.max(line.get_ydata()) for line in tool.lines[:3])))[1]
    assert all(text.get_window_extent().y0 > highest for text in tool.texts)  # no name over a curve
    seen = np.column_stack(curves(axes_titled(figure, "position error"), "-")[:3])
    np.testing.assert_array_equal(seen, run.phase("approach").task.position_error)
    np.testing.assert_array_equal(curves(normal, "-")[0], np.linalg.norm(run.extra["contact.normal_force"], axis=1))
    np.testing.assert_array_equal(curves(normal, "--")[0], np.full(len(run.phase("press")), 4.0))


# -------------------------------------------------------------------- several runs


def test_a_comparison_shows_norms_and_overall_numbers(many: Any) -> None:
    runs = {"first": many(2), "the second law": many(2, q_ref=0.0)}
    figure = compare(runs, title="two runs")
    assert_legible(figure)
    norms = curves(axes_titled(figure, "norm of the tracking error"), "-")
    for norm, run in zip(norms, runs.values(), strict=True):
        np.testing.assert_allclose(norm, np.linalg.norm(run.error, axis=1))
    bars = axes_titled(figure, "effort [(N m)² s]").patches
    assert [bar.get_width() for bar in bars] == [run.metrics.overall("effort") for run in runs.values()]
    assert figure.get_suptitle() == "two runs"


def test_a_comparison_is_legible_for_one_and_for_eight_runs(many: Any) -> None:
    for count in (1, 8):
        assert_legible(compare({f"run number {i}": many(2) for i in range(count)}))


def test_names_of_runs_stand_whole_beside_their_bars(many: Any) -> None:
    figure = compare({"torque sensor and inner loop": many(2), "current alone": many(2)})
    assert_legible(figure)
    names = [label.get_text() for ax in figure.findobj(matplotlib.axes.Axes) for label in ax.get_yticklabels()]
    assert {"torque sensor and\ninner loop", "current alone"} <= set(names)


@pytest.mark.part(1)
@pytest.mark.parametrize("count", [1, 2, 8])
def test_joints_in_rad_and_in_m_are_compared_each_with_their_own(many: Any, count: int) -> None:
    units = ("rad", "m", "rad")
    runs = {f"run number {i}": many(3, units=units, q_ref=0.1 * i) for i in range(count)}
    figure = compare(runs, measures=["rms_error", "effort", "energy"])
    assert_legible(figure)
    for unit, joints in {"rad": [0, 2], "m": [1]}.items():
        ax = axes_titled(figure, f"norm of the tracking error of the joints in {unit}")
        assert ax.get_ylabel() == f"[{unit}]"
        for norm, run in zip(curves(ax, "-"), runs.values(), strict=True):
            np.testing.assert_allclose(norm, np.linalg.norm(run.error[:, joints], axis=1))
        bars = axes_titled(figure, f"RMS error [{unit}]").patches
        assert [bar.get_width() for bar in bars] == [run.metrics.by_unit("rms_error")[unit] for run in runs.values()]
    assert axes_titled(figure, "effort [(N m)² s]").patches
    assert axes_titled(figure, "effort [N² s]").patches
    shown = [ax.get_title(loc="left") for ax in figure.findobj(matplotlib.axes.Axes) if ax.get_visible()]
    assert [title for title in shown if title.startswith("energy")] == ["energy [J]"]
    names = [label.get_text() for ax in figure.findobj(matplotlib.axes.Axes) for label in ax.get_yticklabels()]
    assert names.count("run number 0") == 2


def test_a_run_without_joints_of_a_unit_has_no_bar_there(many: Any) -> None:
    figure = compare({"arm": many(2), "gantry": many(2, units=("m", "m"))}, measures=["peak_error"])
    assert_legible(figure)
    assert len(curves(axes_titled(figure, "norm of the tracking error"), "-")) == 1
    assert axes_titled(figure, "peak error [m]").texts[0].get_text() == "-"


def test_a_title_keeps_the_way_out_of_a_run_that_diverged(many: Any) -> None:
    words = (
        "the simulation diverged at t = 0.012 s (tick 12): joint 'a_rather_long_joint_name_1' is at 1.2e+12 rad and "
        "moves at 3.4e+14 rad/s; try smaller gains, a higher rate or more substeps"
    )
    for n in (1, 2):
        figure = many(n, outcome=taut.Outcome(kind="diverged", message=words, tick=12)).plot()
        assert words in " ".join(figure.get_suptitle().split())
        assert max(map(len, figure.get_suptitle().splitlines())) <= 96
        assert_legible(figure)


def test_the_error_of_one_joint_keeps_its_sign(make_run: Any) -> None:
    """An error that goes through zero is not reflected there."""
    t = np.arange(100) * 0.1
    runs = {name: make_run(t, np.outer(np.cos(t), [size])) for name, size in (("wide", 1.0), ("narrow", 0.2))}
    ax = axes_titled(compare(runs), "tracking error")
    for curve, run in zip(curves(ax, "-")[:2], runs.values(), strict=True):
        np.testing.assert_array_equal(curve, run.error[:, 0])
    axes = [ax for ax in compare(runs, title="two", torques=True).axes if ax.get_visible()]
    assert [ax.get_title(loc="left") for ax in axes[:2]] == ["tracking error", "torque"]
    assert curves(axes[0], "-")[0].min() < -0.9


def test_metrics_without_a_number_are_marked(make_run: Any) -> None:
    t = np.arange(100) * 0.01
    q = t[:, np.newaxis]
    runs = {"a set-point": make_run(t, q, q_ref=1.0), "a path": make_run(t, q, q_ref=q)}
    figure = compare(runs, measures=["settling_time", "saturation_time", "overshoot", "final_z"])
    words = {text.get_text() for text in figure.findobj(Text)}
    assert {"inf", "-"} <= words
    assert not any("final" in word for word in words)  # no run has it
    figure.savefig(BytesIO(), format="png")


def test_five_metrics_stand_in_two_even_rows_with_titles_that_do_not_touch(many: Any) -> None:
    measures = ["steady_state_error", "rms_error", "peak_error", "effort", "settling_time"]
    figure = compare({"a": many(1), "b": many(1)}, measures=measures)
    assert_legible(figure)
    bars = [ax for ax in figure.axes if ax.get_visible()][1:]
    assert sorted(round(ax.get_position().y0, 3) for ax in bars).count(round(bars[0].get_position().y0, 3)) == 3
    boxes = [ax._left_title.get_window_extent() for ax in bars[:3]]  # type: ignore[attr-defined]
    assert all(one.x1 < other.x0 for one, other in itertools.pairwise(boxes))


def test_a_figure_without_runs_is_refused() -> None:
    with refused(taut.errors.UsageError):
        compare({})


def test_one_joint_of_several_runs_is_compared_by_its_motion_error_and_numbers(many: Any) -> None:
    runs = {"a": many(3), "b": many(3)}
    name = runs["a"].joint_names[1]
    figure = compare(runs, measures=["rms_error"], joint=name)
    above, below = axes_titled(figure, f"position of {name}"), axes_titled(figure, "tracking error")
    np.testing.assert_array_equal(above.lines[0].get_ydata(), runs["a"].q[:, 1])
    assert len(above.lines) == 4  # the motions and references, without a line at zero
    error = runs["b"].error
    assert error is not None
    np.testing.assert_array_equal(below.lines[1].get_ydata(), error[:, 1])
    widths = [bar.get_width() for bar in axes_titled(figure, "RMS error [rad]").patches]
    assert widths == [run.metrics.rms_error[1] for run in runs.values()]
    assert_legible(figure)
