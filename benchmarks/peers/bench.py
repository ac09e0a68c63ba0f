"""taut against its peers from PyPI: the same arm, states and laws, each peer in an environment of its own.

`make bench-peers` runs all; `python bench.py NAME...` runs some. Environments are made in .peers/ at the first run. Peer
and taut take turns in every round, each in a process of its own, and what is compared is processor time, so that other
work on the machine counts little. Torques, final positions and errors of each case are compared with those of taut first.
Figures are written to out/bench_peers.json; `python page.py` puts them into docs/benchmarks.md.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
sys.path.insert(0, str(HERE.parent))

import rivals
import task_rivals
from peer_taut import arm_of
from rich.console import Console

import taut

ENVIRONMENTS = REPOSITORY / ".peers"
INSTALL_LIMIT: Final = 1800.0  # [s] that pip may take for one peer
CASE_LIMIT: Final = 900.0  # [s] that a case may take to be ready, or a burst of it
BURST: Final = 0.03  # [s] of processor time that a turn takes, or one call
CHAINS: Final = (1, 2, 3, 5, 7, 10, 15, 20, 30)
SAMPLES: Final = (1, 8, 64, 512, 4096)
TOLERANCES: Final = {  # relative to the largest number, of a case and its precision
    "tick": 1e-8,
    "task_tick": 1e-8,
    "loop": 1e-6,
    "sweep": 1e-6,
    "float32": 2e-3,
}


@dataclass(frozen=True)
class Peer:
    """What is installed for a peer, and what it is asked.

    Args:
        title: In tables.
        packages: For pip; the first gives its name to the environment.
        kinds: Of cases.
        chains: It takes part in the growth with the number of joints.
    """

    title: str
    packages: tuple[str, ...]
    kinds: tuple[str, ...] = ("tick", "task_tick", "loop")
    chains: bool = False


PEERS: Final[Mapping[str, Peer]] = {
    "pinocchio": Peer("NumPy + Pinocchio", ("pin",), chains=True),
    "dynibo": Peer("NumPy + dynibo", ("dynibo", "numpy"), chains=True),
    "mujoco": Peer("NumPy + MuJoCo", ("mujoco",), chains=True),
    "drake": Peer("Drake", ("drake",)),
    "jax": Peer("JAX, written by hand", ("jax",), ("tick", "task_tick", "loop", "sweep", "graph_sweep")),
    "mjx": Peer("MJX", ("mujoco-mjx", "jax"), ("tick", "loop", "sweep")),
    "frax": Peer("frax (JAX)", ("frax", "jax")),
    "adam": Peer("adam (CasADi)", ("adam-robotics", "casadi")),
    "brax": Peer("Brax (JAX)", ("brax", "jax"), ("tick",)),
    "roboticstoolbox": Peer("Robotics Toolbox for Python", ("roboticstoolbox-python",)),
    "manipulapy": Peer("ManipulaPy", ("ManipulaPy",), ("tick",)),
    "modern_robotics": Peer("modern_robotics", ("modern_robotics", "numpy"), ("tick", "loop")),
    "mujoco_warp": Peer("MuJoCo Warp", ("mujoco-warp", "warp-lang"), ("sweep",)),
}


BASE: Final = '<inertial><origin xyz="0 0 0" rpy="0 0 0"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
Body = tuple[float, Any, Any]  # mass, centre of mass, inertia about it


def in_frame(place: taut.Pose, mass: float, com: Any, inertia: Any) -> Body:
    return mass, place.p + place.R @ com, place.R @ inertia @ place.R.T


def together(one: Body, other: Body) -> Body:
    """Two bodies as one."""
    mass = one[0] + other[0]
    com = (one[0] * one[1] + other[0] * other[1]) / mass
    inertia = np.zeros((3, 3))
    for m, c, I in (one, other):
        d = c - com
        inertia = inertia + I + m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, com, inertia


def description(name: str, arm: taut.Arm, bodies: list[Body]) -> str:
    """The arm as URDF, with the exact numbers; the tool is a frame without mass."""

    def xyz(numbers: Iterable[float]) -> str:
        return " ".join(repr(float(x)) for x in numbers)

    def origin(p: Iterable[float], R: Any) -> str:
        yaw, roll = np.arctan2(R[1, 0], R[0, 0]), np.arctan2(R[2, 1], R[2, 2])
        return f'<origin xyz="{xyz(p)}" rpy="{xyz((roll, np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])), yaw))}"/>'

    links = ["world_link", *(f"link{i + 1}" for i in range(arm.n))]
    text = [f'<robot name="{name}">', f'<link name="{links[0]}">{BASE}</link>']
    for i, (joint, (mass, com, full)) in enumerate(zip(arm.joints, bodies, strict=True)):
        assert np.array_equal(joint.axis, [0.0, 0.0, 1.0])
        assert joint.parent == i - 1
        inertia = " ".join(
            f'i{a}{b}="{float(full["xyz".index(a), "xyz".index(b)])!r}"' for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
        )
        text += [
            f'<link name="{links[i + 1]}"><inertial><origin xyz="{xyz(com)}" rpy="0 0 0"/>',
            f'<mass value="{float(mass)!r}"/><inertia {inertia}/></inertial></link>',
            f'<joint name="{joint.name}" type="revolute"><parent link="{links[i]}"/><child link="{links[i + 1]}"/>',
            origin(joint.placement.p, joint.placement.R) + '<axis xyz="0 0 1"/>',
            '<limit lower="-6.5" upper="6.5" effort="1000" velocity="100"/></joint>',
        ]
    tool = arm.frame().placement
    text += [
        '<link name="tool"/>',
        f'<joint name="tool_joint" type="fixed"><parent link="{links[-1]}"/><child link="tool"/>',
        origin(tool.p, tool.R) + "</joint>",
        "</robot>",
    ]
    return "\n".join(text)


def data_of(arm: taut.Arm, rng: np.random.Generator) -> dict[str, Any]:
    """Numbers of an arm, states, and the motion of its loop."""
    tool, n = arm.frame().placement, arm.n
    panda = arm.n == rivals.N and "panda" in arm.name
    frequency = rivals.FREQUENCY if panda else np.linspace(0.2, 0.5, n)
    center = rivals.CENTER if panda else arm.home
    still = np.outer([1.0, 0.0, 1.0, 0.0, 0.0], arm.home)  # q, v, q_des, v_des, a_des
    return {
        "joints": [
            {"name": j.name, "p": j.placement.p.tolist(), "R": j.placement.R.tolist(), "wxyz": j.placement.wxyz.tolist()}
            for j in arm.joints
        ],
        "tool": {"p": tool.p.tolist(), "R": tool.R.tolist(), "wxyz": tool.wxyz.tolist()},
        "gravity": arm.gravity.tolist(),
        "states": (rng.standard_normal((20, 5, n)) + still).tolist(),
        "sine": np.stack(
            [center, np.full(n, rivals.AMPLITUDE if panda else 0.1), 2.0 * np.pi * frequency]
        ).tolist(),
    }


def write_task(folder: Path) -> None:
    """The task for all peers: task.json and a URDF file for each robot."""
    rng = np.random.default_rng(0)
    loaded = (rivals.PAYLOAD_MASS, rivals.PAYLOAD_COM, rivals.PAYLOAD_INERTIA)
    robots: dict[str, Any] = {}
    for name in ("panda", *(f"chain{n}" for n in CHAINS)):
        arm = arm_of(name)
        data = data_of(arm, rng)
        bodies = [(b.mass, b.com, b.inertia) for b in arm.bodies]
        held = [*bodies[:-1], together(bodies[-1], in_frame(arm.frame().placement, *loaded))]
        for key, each in ((name, bodies), (f"{name}_loaded", held)):
            listed = [{"mass": m, "com": c.tolist(), "inertia": I.tolist()} for m, c, I in each]
            robots[key] = {**data, "bodies": listed}
            (folder / f"{key}.urdf").write_text(description(key, arm, each))
    arm = arm_of("panda")
    near = [arm.home + 0.2 * rng.standard_normal(rivals.N) for _ in range(20)]
    targets = []
    for state, q in zip(robots["panda"]["states"], near, strict=True):
        state[0] = q.tolist()
        pose = taut.snapshot(arm, q).T() @ taut.Pose(0.05 * rng.standard_normal(3), rpy=0.2 * rng.standard_normal(3))
        rows = pose.p, pose.R, rng.standard_normal(6), rng.standard_normal(6)
        targets.append([row.tolist() for row in rows])
    robots["panda"]["targets"] = targets
    count = max(SAMPLES)
    gains = np.column_stack(
        [rng.uniform(50.0, 400.0, count), rng.uniform(10.0, 60.0, count), rng.uniform(0.0, 2.0, count)]
    )
    impedance = {
        "K": np.diag(task_rivals.K), "B": np.diag(task_rivals.B), "rest": arm.home,
        "kp": task_rivals.REST_KP, "kd": task_rivals.REST_KD,
    }  # fmt: skip
    task = {
        "kp": 100.0,
        "kd": 20.0,
        "dt": rivals.DT,
        "impedance": {name: np.asarray(value).tolist() for name, value in impedance.items()},
        "payload": {name: np.asarray(value).tolist() for name, value in zip(("mass", "com", "inertia"), loaded, strict=True)},
        "gains": gains.tolist(),
        "robots": robots,
    }
    (folder / "task.json").write_text(json.dumps(task))


class Failed(Exception):
    """What happened to a peer, in words."""


class Worker:
    """The process of a peer. It is started when it is first asked, and again after one that ended."""

    def __init__(self, python: Path, module: str, folder: Path, packages: Iterable[str], name: str) -> None:
        names = [package.split("[")[0] for package in packages]
        self._command = [str(python), str(HERE / "worker.py"), module, str(folder), *names]
        self._process: subprocess.Popen[bytes] | None = None
        self._name = name
        self.versions: dict[str, str] = {}

    def ask(self, **request: Any) -> dict[str, Any]:
        """The answer to a request."""
        if self._process is None:
            environment = dict(os.environ)
            if self._name != "taut":
                environment.pop("PYTHONPATH", None)
            log = (ENVIRONMENTS / f"{self._name}.log").open("ab")
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, env=environment
            )
            self.versions = self._answer()["versions"]
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(request).encode() + b"\n")
        self._process.stdin.flush()
        answer = self._answer()
        if "error" in answer:
            raise Failed(answer["error"])
        return answer

    def _answer(self) -> dict[str, Any]:
        assert self._process is not None
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], CASE_LIMIT)
        line = self._process.stdout.readline() if ready else b""
        if not line:
            text = "" if not ready else (ENVIRONMENTS / f"{self._name}.log").read_text(errors="replace")
            self.stop()
            words = [row for row in text.splitlines() if row.strip()][-1:] or [f"no answer in {CASE_LIMIT:.0f} s"]
            raise Failed(words[0][:200])
        return json.loads(line)

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def installed(name: str, peer: Peer) -> tuple[Path, dict[str, Any]]:
    """The interpreter of a peer's environment, made if it is not there, and what that took."""
    folder = ENVIRONMENTS / name
    python, stamp = folder / "bin" / "python", folder / "installed.json"
    if stamp.exists():
        return python, json.loads(stamp.read_text())
    shutil.rmtree(folder, ignore_errors=True)
    began = time.perf_counter()
    try:
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True, capture_output=True, timeout=INSTALL_LIMIT)
        pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--prefer-binary"]
        subprocess.run([*pip, *peer.packages], check=True, capture_output=True, timeout=INSTALL_LIMIT, text=True)
    except subprocess.TimeoutExpired as cause:
        raise Failed(f"not installed in {INSTALL_LIMIT:.0f} s") from cause
    except subprocess.CalledProcessError as cause:
        words = [line for line in str(cause.stderr).splitlines() if "ERROR" in line or "error" in line]
        raise Failed(f"pip: {(words or ['failed'])[0][:200]}") from cause
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file() and not file.is_symlink())
    found = {"seconds": round(time.perf_counter() - began), "megabytes": round(size / 1e6)}
    stamp.write_text(json.dumps(found))
    return python, found


def cases_of(peer: Peer) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """The cases of a peer, each with the one of taut that takes turns with it."""
    single = {"kind": "run", "robot": "panda"}
    out: list[tuple[dict[str, Any], dict[str, Any]]] = []
    for kind in peer.kinds:
        if kind == "tick":
            out.append(({"kind": "tick", "robot": "panda"}, {"kind": "tick", "robot": "panda"}))
        elif kind == "task_tick":
            out.append(({"kind": "task_tick"}, {"kind": "task_tick"}))
        elif kind == "loop":
            out.append(({"kind": "loop", "robot": "panda"}, single))
        else:
            for real in ("float64", "float32"):
                case = {"kind": kind, "samples": 1024, "ticks": 100, "real": real}
                lanes = {"kind": "sweep", "samples": 4096, "ticks": 1000, "real": {"float64": "double"}.get(real, "float")}
                out.append((case, lanes))
    if peer.chains:
        for n in CHAINS:
            robot = {"robot": f"chain{n}"}
            out += [({"kind": "tick", **robot}, {"kind": "tick", **robot}), ({"kind": "loop", **robot}, {"kind": "run", **robot})]
    return out


def expected_of(own: Worker, case: Mapping[str, Any], steps: int) -> Any:
    """What taut gives where the peer gives its result."""
    if case["kind"] in ("tick", "task_tick"):
        return np.array(own.ask(case=dict(case), burst=BURST)["result"])
    if case["kind"] == "loop":
        robot = case.get("robot", "panda")
        return np.array(own.ask(case={"kind": "run", "robot": robot}, burst=BURST)["result"])[steps]
    few = {"kind": "sweep", "samples": case["samples"], "ticks": case["ticks"], "real": "double"}
    return np.array(own.ask(case=few, burst=BURST)["result"])


def compared(own: Worker, other: Worker, case: dict[str, Any], mate: dict[str, Any], rounds: int) -> dict[str, Any]:
    """One row: both take turns, after the peer has been found to compute the same."""
    try:
        ready = other.ask(case=case, burst=BURST)
        expected = expected_of(own, case, ready["steps"])
        difference = float(np.abs(np.array(ready["result"]) - expected).max() / np.abs(expected).max())
        tolerance = TOLERANCES["float32" if case.get("real") == "float32" else case["kind"].removeprefix("graph_")]
        if not difference <= tolerance:
            raise Failed(f"differs from taut by {difference:.2g} of the largest number")
        mine = own.ask(case=mate, burst=BURST)
        pairs = []
        for _ in range(rounds):
            pair = [
                own.ask(case=mate, budget=True, n=mine["n"])["core"],
                other.ask(case=case, budget=True, n=ready["n"])["core"],
            ]
            pairs.append(pair)
    except Failed as what:
        return {"case": case, "error": str(what)}
    return {
        "case": case,
        "how": ready["how"],
        "ready": ready["ready"],
        "difference": difference,
        "mate": mate,
        "mate_how": mine["how"],
        "rounds": pairs,
    }


def measured(name: str, peer: Peer, own: Worker, folder: Path, rounds: int, console: Console) -> dict[str, Any]:
    """All rows of a peer."""
    try:
        python, install = installed(name, peer)
    except Failed as what:
        return {"title": peer.title, "error": str(what)}
    other = Worker(python, f"peer_{name}", folder, peer.packages, name)
    rows = []
    for case, mate in cases_of(peer):
        row = compared(own, other, case, mate, rounds)
        rows.append(row)
        words = row.get("error")
        if words is None:
            mine, theirs = np.median(np.array(row["rounds"]), axis=0)
            words = f"{1e6 * theirs:.3g} us a step, {times(row):.3g} x"
        console.print(f"{name} {' '.join(str(x) for x in case.values())}: {words}", highlight=False, soft_wrap=True)
    other.stop()
    return {"title": peer.title, "versions": other.versions, "install": install, "rows": rows}


def times(row: Mapping[str, Any]) -> float:
    """How many times the processor time of taut the peer takes: median over the rounds."""
    pairs = np.array(row["rounds"])
    return float(np.median(pairs[:, 1] / pairs[:, 0]))


def growth(own: Worker, rounds: int) -> dict[str, Any]:
    """How the cost of taut grows: with the law, joints, samples, lanes and threads; cases take turns."""
    groups: dict[str, list[dict[str, Any]]] = {
        "laws": [{"kind": "law_tick", "name": name} for name in LAWS],
        "joints": [
            {"kind": kind, "robot": f"chain{n}"} for n in CHAINS for kind in ("compile", "tick", "bound_tick", "bare_loop")
        ],
        "loop": [{"kind": kind, "robot": "panda"} for kind in ("bound_tick", "tick", "run", "bare_loop")],
        "samples": [
            {"kind": "sweep", "samples": n, "ticks": 1000, "real": real} for real in ("double", "float") for n in SAMPLES
        ],
        "threads": [
            {"kind": "sweep", "samples": 8192, "ticks": 1000, "real": "double", "workers": n}
            for n in range(1, 1 + len(os.sched_getaffinity(0)))
        ],
    }
    out: dict[str, Any] = {}
    for name, cases in groups.items():
        rows = []
        for case in cases:
            try:
                ready = own.ask(case=case, burst=BURST)
                rows.append({"case": case, "how": ready["how"], "result": np.ravel(ready["result"])[:1].tolist(), "n": ready["n"]})
            except Failed as what:
                rows.append({"case": case, "error": str(what)})
        for _ in range(rounds):
            for row in rows:
                if "n" in row:
                    answer = own.ask(case=row["case"], budget=True, n=row["n"])
                    row.setdefault("rounds", []).append([answer["core"], answer["wall"]])
        out[name] = rows
    return out


LAWS: Final = (
    "PID",
    "GravityPID",
    "ComputedTorque",
    "Impedance(K, B, null=None)",
    "Impedance(K, B)",
    "TaskComputedTorque",
    "Impedance(K, zeta)",
)


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    model = next((line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line), "")
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=Path(taut.__file__).parent, capture_output=True, text=True)
    return {
        "processor": model,
        "cores": len(os.sched_getaffinity(0)),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "taut": commit.stdout.strip(),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
    }


def main() -> None:
    console = Console(width=140)
    names = [word for word in sys.argv[1:] if not word.isdigit()] or [*PEERS, "growth"]
    rounds = next((int(word) for word in sys.argv[1:] if word.isdigit()), 9)
    out = REPOSITORY / "out" / "bench_peers.json"
    folder = out.parent / "bench_peers"
    folder.mkdir(parents=True, exist_ok=True)
    ENVIRONMENTS.mkdir(exist_ok=True)
    write_task(folder)
    found = json.loads(out.read_text()) if out.exists() else {"peers": {}}
    own = Worker(Path(sys.executable), "peer_taut", folder, ("taut",), "taut")
    own.ask(case={"kind": "graph"}, burst=0.0)
    for name in names:
        load = os.getloadavg()[0]
        if name == "growth":
            found["growth"] = growth(own, rounds)
            found["growth"]["load"] = load
        else:
            found["peers"][name] = {**measured(name, PEERS[name], own, folder, rounds, console), "load": load}
        found["machine"], found["rounds"] = machine(), rounds
        out.write_text(json.dumps(found, indent=1))
    own.stop()
    console.print(f"figures in {out}")


if __name__ == "__main__":
    main()
