"""taut against its peers from PyPI: the same arm, states and laws, each peer in an environment of its own.

`make bench-peers` runs all of it and writes docs/benchmarks.md; `python bench.py NAME...` runs some peers and prints
their rows. Environments are made in .peers/ at the first run. A case of a peer is first compared with taut's, then
both take turns in every round. Times are processor time, so that other work on the machine counts little.
"""

from __future__ import annotations

import json
import os
import platform
import select
import shutil
import subprocess
import sys
import venv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from peer_taut import CASES, write_graphs
from task import CHAINS, SAMPLES, write_task
from worker import Cases, Task

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
ENVIRONMENTS = REPOSITORY / ".peers"
ROUNDS: Final = 7
LIMIT: Final = 180.0  # [s] that a peer may take for an answer; pip may take ten times as long
LANES: Final = {"kind": "sweep", "samples": SAMPLES, "ticks": 1000}
ALONE: Final = {"JAX_PLATFORMS": "cpu", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
TOLERANCES: Final = {  # of a peer's numbers against taut's, relative to the largest of these
    "tick": 1e-9,
    "impedance": 1e-9,
    "loop": 1e-9,
    "sweep": 1e-6,
    "float32": 1e-3,
}


@dataclass(frozen=True)
class Peer:
    """A peer, and what it is asked.

    Args:
        title: In tables.
        packages: For pip, by name and version.
        kinds: Of cases.
        chains: It is also asked for chains of 1 to 30 joints.
        reals: Types of numbers in which it runs many loops.
    """

    title: str
    packages: Mapping[str, str]
    kinds: Sequence[str] = ("tick", "impedance", "loop")
    chains: bool = False
    reals: Sequence[str] = ("float64",)


MUJOCO: Final = {"mujoco": "4.0.0", "numpy": "2.4.6"}
JAX: Final = {"jax": "0.10.2", "jaxlib": "0.10.2", "numpy": "2.4.6"}
PEERS: Final[Mapping[str, Peer]] = {
    "pinocchio": Peer("NumPy + Pinocchio", {"pin": "4.1.0", "numpy": "2.4.6"}, chains=True),
    "dynibo": Peer("NumPy + dynibo", {"dynibo": "0.5.2", "numpy": "2.4.6"}),
    "mujoco": Peer("NumPy + MuJoCo", MUJOCO),
    "drake": Peer("Drake", {"drake": "1.51.1", "numpy": "2.4.6"}),
    "roboticstoolbox": Peer("Robotics Toolbox", {"roboticstoolbox-python": "1.5.0", "numpy": "2.4.6"}),
    "modern_robotics": Peer("modern_robotics", {"modern_robotics": "1.1.1", "numpy": "2.4.6"}, ("tick", "loop")),
    "mjx": Peer("MJX", {"mujoco-mjx": "3.17.0", **MUJOCO, **JAX}, ("tick", "loop", "sweep")),
    "jax": Peer("JAX", JAX, ("tick", "loop", "sweep"), reals=("float64", "float32")),
}


class PeerError(Exception):
    """What happened to a peer, in its words."""


class Process:
    """The process of a peer, with the verbs of `worker.Cases`."""

    def __init__(self, python: Path, module: str, folder: Path, packages: Sequence[str]) -> None:
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | ALONE
        self._log = folder / f"{module}.log"
        command = [str(python), str(HERE / "worker.py"), module, str(folder), *packages]
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, env=environment
            )
        os.sched_setaffinity(self._process.pid, {min(os.sched_getaffinity(0))})  # XLA takes all that it is given
        try:
            self.versions = self._answer()
        except PeerError:
            self.stop()
            raise

    def made(self, case: Mapping[str, Any]) -> dict[str, Any]:
        return self._ask("made", case)

    def turn(self, case: Mapping[str, Any]) -> float:
        return float(self._ask("turn", case)["seconds"])

    def stop(self) -> None:
        """End it."""
        self._process.kill()
        self._process.communicate()

    def _ask(self, verb: str, case: Mapping[str, Any]) -> dict[str, Any]:
        if self._process.poll() is not None or self._process.stdin is None:
            raise PeerError("its process has ended")
        self._process.stdin.write(json.dumps({"verb": verb, "case": case}).encode() + b"\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        ready, _, _ = select.select([self._process.stdout], [], [], LIMIT)
        line = self._process.stdout.readline() if ready and self._process.stdout else b""
        if not line:
            self.stop()
            lines = self._log.read_text(errors="replace").split("\n") if ready else [f"no answer in {LIMIT:.0f} s"]
            raise PeerError(next((x for x in reversed(lines) if x.strip()), "it ended without a word"))
        found: dict[str, Any] = json.loads(line)
        if "error" in found:
            raise PeerError(found["error"])
        return found


def installed(name: str, peer: Peer) -> Path:
    """The interpreter of a peer's environment, which is made where there is none with these versions."""
    folder = ENVIRONMENTS / name
    python, stamp = folder / "bin" / "python", folder / "installed.json"
    if stamp.exists() and json.loads(stamp.read_text()) == peer.packages:
        return python
    print(f"{name}: pip install {' '.join(peer.packages)}", flush=True)
    shutil.rmtree(folder, ignore_errors=True)
    venv.create(folder, with_pip=True)
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--prefer-binary"]
    wanted = [f"{package}=={number}" for package, number in peer.packages.items()]
    try:
        subprocess.run([*pip, *wanted], check=True, capture_output=True, timeout=10.0 * LIMIT, text=True)
    except subprocess.TimeoutExpired as cause:
        raise PeerError(f"pip took more than {10.0 * LIMIT:.0f} s") from cause
    except subprocess.CalledProcessError as cause:
        raise PeerError(next((x for x in cause.stderr.splitlines() if "ERROR" in x), "pip failed")[:200]) from cause
    stamp.write_text(json.dumps(peer.packages))
    return python


def cases_of(peer: Peer) -> list[dict[str, Any]]:
    """What a peer is asked."""
    forms: dict[str, list[dict[str, Any]]] = {
        "tick": [{"robot": "panda"}],
        "impedance": [{}],
        "loop": [{"robot": "panda"}],
        "sweep": [{"samples": 1024, "ticks": 20, "real": real} for real in peer.reals],
    }
    cases = [{"kind": kind, **form} for kind in peer.kinds for form in forms[kind]]
    chains = [{"kind": kind, "robot": f"chain{n}"} for n in CHAINS for kind in ("tick", "loop")]
    return cases + (chains if peer.chains else [])


def mates_of(case: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The cases of taut that take turns with it."""
    if case["kind"] == "sweep":
        return [{**LANES, "real": "double" if case["real"] == "float64" else "float"}]
    if case["kind"] != "loop":
        return [dict(case)]
    robot = {"robot": case["robot"]}
    return [{"kind": "run", **robot}, LANES if case["robot"] == "panda" else {"kind": "bare_loop", **robot}]


def expected_of(own: Cases, case: Mapping[str, Any], steps: int) -> Any:
    """What taut gives where the peer gives its result."""
    if case["kind"] == "loop":
        return own.made({"kind": "run", "robot": case["robot"]})["result"][steps]
    return own.made({name: value for name, value in case.items() if name != "real"})["result"]


def compared(own: Cases, other: Process, case: dict[str, Any], rounds: int = ROUNDS) -> dict[str, Any]:
    """One row: the peer and taut take turns, after they have been found to compute the same."""
    try:
        ready = other.made(case)
        expected = expected_of(own, case, ready["steps"])
        difference = float(np.abs(ready["result"] - expected).max() / np.abs(expected).max())
        tolerance = TOLERANCES.get(case.get("real", ""), TOLERANCES[case["kind"]])
        if not difference <= tolerance:
            raise PeerError(f"differs from taut by {difference:.2g} of the largest number")
        mates = mates_of(case)
        for mate in mates:
            own.made(mate)
        turns = [[other.turn(case), *(own.turn(mate)["seconds"] for mate in mates)] for _ in range(rounds)]
    except PeerError as what:
        return {"case": case, "error": str(what)}
    row = {"case": case, "how": ready["how"], "first": ready["first"], "difference": difference}
    return {**row, "mates": mates, "seconds": turns}


def measured(name: str, peer: Peer, own: Cases, folder: Path) -> dict[str, Any]:
    """All rows of a peer."""
    try:
        other = Process(installed(name, peer), f"peer_{name}", folder, list(peer.packages))
    except PeerError as what:
        print(f"{name}: {what}")
        return {"title": peer.title, "packages": dict(peer.packages), "error": str(what), "rows": []}
    rows = []
    for case in cases_of(peer):
        rows.append(compared(own, other, case))
        print(name, *case.values(), words_of(rows[-1]), flush=True)
    other.stop()
    return {"title": peer.title, "packages": other.versions, "rows": rows}


def words_of(row: Mapping[str, Any]) -> str:
    if "error" in row:
        return row["error"]
    times = np.array(row["seconds"])
    ratios = ", ".join(f"{x:.3g}" for x in np.median(times[:, :1] / times[:, 1:], axis=0))
    return f"{1e6 * np.median(times[:, 0]):.3g} us a step, {ratios} times taut's"


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return {
        "processor": next((line.split(":")[1].strip() for line in lines if "model name" in line), platform.machine()),
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.system(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in ("taut", "numpy", "llvmlite")},
        "load": os.getloadavg()[0],
    }


def main() -> None:
    names = sys.argv[1:] or list(PEERS)
    out = REPOSITORY / "out" / "bench_peers"
    out.mkdir(parents=True, exist_ok=True)
    write_task(out)
    task = Task(out)
    own, before = Cases(task, CASES), machine()
    write_graphs(task)
    peers = {name: measured(name, PEERS[name], own, out) for name in names}
    if sys.argv[1:]:
        return
    import growth
    import page

    record = {"machine": before, "rounds": ROUNDS, "peers": peers, **growth.measured(ROUNDS)}
    (out / "record.json").write_text(json.dumps(record, indent=1))
    page.write(record)


if __name__ == "__main__":
    main()
