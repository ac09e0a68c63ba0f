"""The force side of a record: errors by hand, windows, what is told, plots, and logs that read back."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.record.comparison_plot import compare
from taut.record.tool import force_error, wanted_wrench

L = taut.laws
ARM = taut.load_arm("planar3")
PRESS = taut.TaskForce(F_app=[3.0, 0.0, -6.0, 0.0, 0.4, 0.0], frame="tool")


@pytest.fixture(scope="module")
def run() -> taut.Run:
    law = L.LossOfContact(law=L.ForceControl(kfp=0.2, kfi=4.0, kdamp=(60.0, 2.0)))
    held = taut.environments.Environments(
        spring=taut.environments.Spring(stiffness=(2e3, 60.0)), damper=taut.environments.Damper(damping=(80.0, 2.0))
    )
    plant = taut.RigidPlant(ARM, friction=None, environment=held)
    free = {"environment.spring.stiffness": [0.0] * 6, "environment.damper.damping": [0.0] * 6}
    return taut.run(taut.compile(law, ARM), plant, PRESS, duration=2.0, events=[taut.Event(t=1.8, set=free)])


def test_a_wrench_in_the_axes_of_the_tool_is_turned_by_where_the_tool_was(run: taut.Run) -> None:
    wanted = wanted_wrench(run)
    assert wanted is not None
    for k in (0, 700, 2000):
        R = taut.snapshot(ARM, run.q[k]).T().R
        np.testing.assert_allclose(wanted[k], [*(R @ PRESS.F_tool[:3]), *(R @ PRESS.F_tool[3:])], atol=1e-12)


def test_errors_are_rms_and_peak_of_the_norm_of_what_was_wanted_less_what_was_applied(run: taut.Run) -> None:
    error, metrics = force_error(run), run.metrics
    assert error is not None
    np.testing.assert_allclose(error, wanted_wrench(run) + run.extra["F_ext"])
    force, moment = np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1)
    assert metrics.force_error_rms == pytest.approx(np.sqrt(np.mean(force**2)))
    assert metrics.force_error_peak == force.max()
    assert metrics.moment_error_rms == pytest.approx(np.sqrt(np.mean(moment**2)))
    assert metrics.moment_error_peak == moment.max()
    window = run.between(1.0, 1.5).metrics
    assert window.force_error_rms == pytest.approx(np.sqrt(np.mean(force[1000:1501] ** 2)))
    assert window.force_error_rms < 0.1 < metrics.force_error_rms


def test_what_is_lost_is_a_column_a_metric_and_a_sentence(run: taut.Run) -> None:
    lost = run.extra["law.lost"]
    assert run.metrics.contact_lost_time == pytest.approx(1e-3 * lost[:-1].sum())
    assert lost[1800:1840].sum() == 0.0
    assert lost[-1] == 1.0
    first = int(np.argmax(lost > 0.0))
    told = f"contact was lost in {int(lost.sum())} of 2001 ticks, first at t = {run.t[first]:.6g} s"
    assert told in run.outcome.message


def test_runs_of_motion_have_no_errors_of_force() -> None:
    out = taut.run(taut.compile(L.PID(kp=1.0), ARM), taut.RigidPlant(ARM), duration=0.01)
    assert force_error(out) is None
    assert np.isnan([out.metrics.force_error_rms, out.metrics.contact_lost_time]).all()


def test_a_log_reads_back_with_its_forces(run: taut.Run, tmp_path: Path) -> None:
    back = taut.load_run(run.save(tmp_path / "force.mcap"))
    np.testing.assert_array_equal(back.reference.F_tool, run.reference.F_tool)  # type: ignore[attr-defined]
    assert back.metrics.force_error_rms == run.metrics.force_error_rms
    assert back.metrics.contact_lost_time == run.metrics.contact_lost_time


def texts(figure: Any) -> str:
    return " | ".join(str(text.get_text()) for text in figure.findobj(lambda x: hasattr(x, "get_text")))


def test_errors_of_force_alone_are_called_what_they_are(run: taut.Run) -> None:
    wanted = wanted_wrench(run)
    assert wanted is not None
    F = np.column_stack([run.extra["F_ext"][:, :3], -wanted[:, 3:]])  # no error of the moment
    shown = texts(compare({"a": dataclasses.replace(run, extra={"F_ext": F})}, measures=["force_error_rms"]))
    assert "norm of the force error" in shown
    assert "force error RMS [N]" in shown


def test_plots_show_what_was_wanted_and_comparisons_the_errors_of_force(run: taut.Run) -> None:
    assert "| wanted |" in texts(run.plot())
    figure = texts(compare({"a": run, "b": run}, window=(1.0, 1.5)))
    assert "norm of the force error" in figure
    assert "norm of the moment error" in figure
    assert "from 1 to 1.5 s" in figure


def test_a_press_may_be_asked_for_as_a_wrench_and_as_multipliers_it_is_not_known(make_run: Any) -> None:
    """0 N, 10 N askew, 4 N: what F_app asks for into the surface is 10 N all the time, 4 N of it sideways no press."""
    t, n = np.arange(3) * 1e-3, np.array([0.0, 0.6, 0.8])
    felt = np.outer([0.0, 10.0, 4.0], n)
    asked = [*(4.0 * np.array([0.0, 0.8, -0.6]) - 10.0 * n), 0.0, 0.0, 0.0]
    told = {}
    for name, forces in {"F_app": {"F_app": asked}, "press": {"press": 10.0}, "lam": {"lam": [-10.0]}}.items():
        sample = taut.pressing(taut.JointMotion(q=[0.0]), **forces)  # type: ignore[arg-type]
        rows = {field: np.tile(getattr(sample, field), (3, 1)) for field in type(sample).fields(1)}
        told[name] = make_run(
            t, np.zeros(3), reference=type(sample).of(rows), extra={"contact.normal_force": felt}
        ).metrics
    for name in ("F_app", "press"):
        assert told[name].normal_force_error_rms == pytest.approx(np.sqrt((10.0**2 + 0.0 + 6.0**2) / 3.0)), name
        assert told[name].normal_force_error_peak == pytest.approx(10.0), name
    assert np.isnan([told["lam"].normal_force_error_rms, told["lam"].normal_force_error_peak]).all()
    assert told["lam"].peak_normal_force == pytest.approx(10.0)
