"""The source distribution, and the wheel that is built of it, installed without an index, used with nothing else."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
WHEELS = REPOSITORY / ".wheels"  # filled by set-up
MOST = 0.7e9  # bytes that the installed core may take

pytestmark = pytest.mark.xdist_group("wheel")  # one environment serves all


def execute(*words: str | Path, cwd: Path) -> str:
    """What a command prints; it must succeed and print no warning."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PIP_"))}
    folder = {"PIP_CONFIG_FILE": os.devnull, "PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(WHEELS)}
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, env={**kept, **folder})
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    execute(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, REPOSITORY, cwd=folder)
    (_,) = folder.glob("*.tar.gz")  # of which it makes the wheel
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment that holds the wheel and what it depends on."""
    assert WHEELS.is_dir(), f"{WHEELS} is missing; 'make test' fills it"
    folder = tmp_path_factory.mktemp("empty") / "env"
    venv.create(folder)
    made = folder / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    pip = ["-m", "pip", "--python", made, "--disable-pip-version-check", "install", "--quiet", "--no-compile"]
    execute(sys.executable, *pip, wheel, cwd=folder)
    return made


def test_the_locked_versions_are_those_that_are_tested() -> None:
    """With hashes, for what taut itself needs, as `make lock` writes them."""
    tested = {
        line.partition("==")[0].lower(): line for line in (REPOSITORY / "constraints.txt").read_text().split("\n")
    }
    locked = [line.split() for line in (REPOSITORY / "locked.txt").read_text().splitlines() if line[0] != "#"]
    assert all(tested[pin.partition("==")[0].lower()] == pin for pin, _ in locked)
    assert all(re.fullmatch("--hash=sha256:[0-9a-f]{64}", found) for _, found in locked)
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = {re.split("[<>=]", one)[0] for one in project["dependencies"]}
    assert needed <= {pin.partition("==")[0] for pin, _ in locked}


def test_tests_of_a_group_run_in_one_process(request: pytest.FixtureRequest) -> None:
    """Or what they share is made twice, in silence: pytest-xdist may miss the marks of a newer pytest."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        assert request.node.nodeid.endswith("@wheel")


def test_the_wheel_ships_what_it_reads_and_nothing_else(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    source = {str(f.relative_to(REPOSITORY / "src")) for f in (REPOSITORY / "src" / "taut").rglob("*") if f.is_file()}
    source = {name for name in source if "__pycache__" not in name}
    shipped = {name for name in names if not name.startswith("taut-")}
    assert shipped == {Path(name).as_posix() for name in source}
    assert "taut/py.typed" in shipped
    assert any(name.startswith("taut/scenarios/files/") and name.endswith(".toml") for name in shipped)
    assert any("LICENSE" in name for name in names)


@pytest.mark.long
def test_an_empty_environment_runs_an_arm_in_both_plants(python: Path, tmp_path: Path) -> None:
    code = """if True:
        import taut
        arm = taut.load_arm("planar2")
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=400.0, kd=40.0), arm)
        assert ctrl.engine == "native"
        goal = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.3, duration=0.5)
        for plant in (taut.RigidPlant(arm), taut.MujocoPlant(arm)):
            run = taut.run(ctrl, plant, goal, duration=1.0)
            assert run.outcome.ok and abs(run.error[-1]).max() < 1e-3, run.outcome
            run.save("run.mcap")
            assert taut.load_run("run.mcap").q.shape == run.q.shape
        run.plot().savefig("run.png")
        print("fine")
    """
    assert execute(python, "-W", "error", "-c", code, cwd=tmp_path) == "fine\n"
    assert (tmp_path / "run.png").stat().st_size > 10_000


@pytest.mark.long
def test_its_command_runs_a_scenario_and_names_a_missing_extra(python: Path, tmp_path: Path) -> None:
    command = python.with_name("taut")
    assert "one_joint_pid" in execute(command, "scenarios", cwd=tmp_path)
    assert "PID" in execute(command, "run", "one_joint_pid", "--out", tmp_path / "out", cwd=tmp_path)
    done = subprocess.run([command, "check", "panda"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert 'pip install -e ".[arms]"' in done.stdout + done.stderr
    assert "Traceback" not in done.stderr


def test_the_core_is_small_enough(python: Path) -> None:
    packages = next(python.parents[1].glob("lib/python3*/site-packages"), python.parents[1] / "Lib" / "site-packages")
    size = sum(file.stat().st_size for file in packages.rglob("*") if file.is_file())
    print(f"the core takes {1e-9 * size:.3f} GB")
    assert 1e7 < size < MOST
