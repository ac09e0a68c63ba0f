"""`taut doctor RUN`: the diagnosis of a log, and a picture of each finding where a folder is named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taut.analysis.diagnosis.diagnosis import Diagnosis, doctor
from taut.arm.load import load_arm
from taut.base.errors import FileError
from taut.record.log.files import written_aside
from taut.record.log.reading import load_run

__all__ = ["Report", "examine"]


@dataclass(frozen=True, kw_only=True)
class Report:
    """The diagnosis of a log, and the pictures that were drawn."""

    log: Path
    diagnosis: Diagnosis
    pictures: tuple[Path, ...]

    @property
    def ok(self) -> bool:
        """Whether the log is one of a whole run."""
        return not self.diagnosis.problems

    def json(self) -> dict[str, Any]:
        """As plain values."""
        pictures = [str(path) for path in self.pictures]
        return {
            "run": str(self.log),
            "healthy": self.diagnosis.healthy,
            **self.diagnosis.json(),
            "pictures": pictures,
        }

    def text(self) -> str:
        """In lines for people."""
        return "\n".join([str(self.diagnosis), *(f"picture {path}" for path in self.pictures)])


def examine(log: Path, arm: str | None, folder: Path | None) -> Report:
    """Diagnose a log.

    Args:
        log: A .mcap file that `run.save` wrote.
        arm: Name or file of the arm that the controller was compiled for; that of the log if left out.
        folder: Where to draw each finding; nowhere if left out.

    Raises:
        FileError: No log, or a folder that cannot be made or written to.
        MatchError: An arm with other joints.
    """
    run = load_run(log)
    diagnosis = doctor(run, arm=None if arm is None else load_arm(arm))
    pictures = []
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as cause:
            raise FileError(f"folder '{folder}' cannot be made: {cause.strerror}", name=str(folder)) from cause
        for i, finding in enumerate(diagnosis.findings, start=1):
            target = folder / f"{i}_{finding.name.replace(' ', '_').replace('-', '_')}.png"
            with written_aside("picture", target) as aside:
                finding.plot().savefig(aside, format="png", dpi=150)
            pictures.append(target)
    return Report(log=log, diagnosis=diagnosis, pictures=tuple(pictures))
