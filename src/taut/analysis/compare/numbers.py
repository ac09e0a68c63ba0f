"""The numbers of one law in a comparison: those of its run, and what noise and a wrong model do to it."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Final, TypeAlias

import numpy as np

from taut.record.metrics import METRICS, Metric
from taut.record.run import Run

__all__ = ["ERRORS", "FIGURES", "Numbers", "main_error", "of_model", "of_noise", "of_run"]

Numbers: TypeAlias = Mapping[str, Mapping[str, float]]
"""A figure by its name and unit: {"rms_error": {"rad": 0.1}}."""

LAST: Final = 0.2  # share of a run whose error is called steady
ERRORS: Final = {
    "error": ("rms_error", "peak_error"),
    "task": ("task_rms", "task_peak"),
    "rotation": ("task_rms_rotation", "task_peak_rotation"),
    "press": ("normal_force_error_rms", "normal_force_error_peak"),
    "force_error": ("force_error_rms", "force_error_peak"),
    "moment_error": ("moment_error_rms", "moment_error_peak"),
}
"""RMS and peak of each error that a run may have."""
STEADY: Final = {f"steady_{error}": names[0] for error, names in ERRORS.items()}
OF_TORQUE: Final = ("effort", "peak_torque", "chatter")


def _own(title: str, unit: str, overall: str) -> Metric:
    return Metric(name=title, title=title, unit=unit, doc=overall, compute=lambda _: None)


def _errors() -> dict[str, Metric]:
    """RMS, peak and steady value of each error."""
    out: dict[str, Metric] = {}
    for error, (rms, peak) in ERRORS.items():
        words = f"{METRICS[rms].title}, last fifth"
        steady = _own(words, METRICS[rms].unit, f"{rms} of the last fifth of the run")
        out |= {rms: METRICS[rms], peak: METRICS[peak], f"steady_{error}": steady}
    return out


FIGURES: Final[Mapping[str, Metric]] = {
    **_errors(),
    "effort": METRICS["effort"],
    "peak_torque": METRICS["peak_torque"],
    "saturation": _own("saturated", "% of ticks", "share of the run in which a limit cut any joint's command"),
    "chatter": METRICS["chatter"],
    "noise_error": _own("error by noise", "{q}", "the first error with noise of the sensors, less that without"),
    "noise_chatter": _own("chatter by noise", "{tau}/s", "chatter with noise of the sensors, less that without"),
    "model_median": _own("wrong model, median", "{q}", "the first error with true arms that differ: the median"),
    "model_worst": _own("wrong model, worst", "{q}", "the first error with true arms that differ: the largest"),
}
"""Every figure that laws may be ranked by, in the order of the table."""


def of_run(run: Run) -> dict[str, dict[str, float]]:
    """What a run shows; a figure without a meaning in it is left out, and all are of one that failed."""
    if not run.outcome.ok:
        return {}
    out = {name: _worst(run, name) for pair in ERRORS.values() for name in pair}
    last = run.between(run.t[-1] - LAST * (run.t[-1] - run.t[0]), run.t[-1])
    out |= {name: _worst(last, of) for name, of in STEADY.items()}
    out |= {name: run.metrics.by_unit(name) for name in OF_TORQUE}
    share = 100.0 / run.metrics.duration
    out["saturation"] = {"% of ticks": share * run.metrics.overall["saturation_time"]}
    return _known(out)


def _worst(run: Run, name: str) -> dict[str, float]:
    """A metric by unit; of laws side by side, which have their own references, the largest of theirs."""
    out: dict[str, float] = {}
    for one in [run.part(part) for part in run.info.parts] or [run]:
        for unit, value in one.metrics.by_unit(name).items():
            out[unit] = float(np.fmax(out.get(unit, math.nan), value))
    return out


def _known(numbers: Numbers) -> dict[str, dict[str, float]]:
    """In the order of the table, without what has no meaning."""
    kept = {
        name: {unit: value for unit, value in numbers.get(name, {}).items() if not math.isnan(value)}
        for name in FIGURES
    }
    return {name: values for name, values in kept.items() if values}


def main_error(numbers: Numbers) -> str | None:
    """The first RMS error that there is: of joints, of the tool, of its force."""
    return next((names[0] for names in ERRORS.values() if names[0] in numbers), None)


def of_noise(noisy: Run, silent: Run) -> dict[str, dict[str, float]]:
    """What the noise of sensors adds to the error and to the chatter."""
    one, other = of_run(noisy), of_run(silent)
    error = main_error(one)
    pairs = {"noise_error": error, "noise_chatter": "chatter"}
    return _known(
        {
            name: {unit: value - other[of][unit] for unit, value in one[of].items()}
            for name, of in pairs.items()
            if of is not None and of in one and of in other
        }
    )


def of_model(runs: Sequence[Run], error: str | None) -> dict[str, dict[str, float]]:
    """Median and largest error over runs whose arms differ; infinite where a run failed."""
    if error is None or not runs:
        return {}
    rows = [of_run(run).get(error, {}) for run in runs]
    units = dict.fromkeys(unit for row in rows for unit in row)
    spread = {unit: [row.get(unit, math.inf) for row in rows] for unit in units}
    return {
        "model_median": {unit: statistics.median(values) for unit, values in spread.items()},
        "model_worst": {unit: max(values) for unit, values in spread.items()},
    }
