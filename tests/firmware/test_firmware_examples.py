"""The examples of docs/firmware.md: compiled with every warning an error, run with a simulated arm, compared with Python.

What stands here in place of a board, of libfranka and of ros2_control are files of our own, beside this one.
"""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import taut

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "examples" / "firmware"
EXPORT = runpy.run_path(str(EXAMPLES / "export.py"))
COMPILERS = {"gcc": ("gcc", "g++"), "clang": ("clang", "clang++")}
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"]
JOINT, TASK, SINGLE = 1e-12, 1e-9, 1e-4  # of the largest torque: laws of joints, of the tool, in single precision


class Dynamics(taut.Law):
    """The arm itself as a law: the reference's acceleration is a torque, the command is the acceleration it causes."""

    home: taut.Gain = taut.Gain(minimum=-10.0, unit="rad")  # where it begins
    p: taut.Memory = taut.Memory(np.zeros(3))
    R: taut.Memory = taut.Memory(np.eye(3))

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> tuple[taut.Torque, dict[str, object]]:
        T = x.T()
        return taut.Torque(a=taut.math.solve(x.M, ref.a - x.h)), {"p": T.p, "R": T.R}


@pytest.fixture(params=[name for name, both in COMPILERS.items() if all(map(shutil.which, both))] or ["none"])
def compilers(request: pytest.FixtureRequest) -> tuple[str, str]:
    """C and C++ of each compiler that is there."""
    if request.param == "none":
        pytest.skip("needs a C++ compiler: apt-get install g++")
    return COMPILERS[request.param]


def export(ctrl: taut.Controller, folder: Path, example: str, prefix: str, real: str = "double") -> Path:
    """A copy of the example with its law in law/, and the dynamics of its arm in plant/."""
    shutil.copytree(EXAMPLES / example, folder, ignore=shutil.ignore_patterns("law"), dirs_exist_ok=True)
    taut.export_c(ctrl, folder / "law", prefix=prefix, real=real)
    arm = ctrl.arm.with_payload(0.1)  # which the law does not know
    home = arm.home + np.linspace(-0.3, 0.2, arm.n)
    plant = taut.compile(Dynamics(home=home), arm, adds=ctrl.side.adds, engine="float")
    taut.export_c(plant, folder / "plant", prefix="plant")
    return folder


def run(*command: object, cwd: Path, check: bool = True, **environment: object) -> subprocess.CompletedProcess[str]:
    variables = {**os.environ, **{name: str(value) for name, value in environment.items()}}
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=cwd, env=variables, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0 or not check, done.stdout + done.stderr
    return done


def trace(folder: Path, columns: int) -> np.ndarray:
    return np.fromfile(folder / "trace").reshape(-1, columns)


def assert_close(torques: np.ndarray, python: np.ndarray, tolerance: float) -> None:
    assert np.abs(python).max() > 1.0  # the arm works
    np.testing.assert_allclose(torques, python, rtol=0.0, atol=tolerance * np.abs(python).max())


# -------------------------------------------------------------------- a bare loop


def test_a_bare_loop_in_c(compilers: tuple[str, str], tmp_path: Path) -> None:
    ctrl = EXPORT["bare_loop"]()
    folder = export(ctrl, tmp_path, "bare_loop", "arm", real="float")
    flags = " ".join([*STRICT, f"-Iplant -I{HERE}"])
    board = f"BOARD={HERE}/board.c plant/plant.c"
    run("make", "-s", f"CC={compilers[0]}", board, cwd=folder, CFLAGS=flags, LDLIBS="-lm")

    bad = range(300, 302)  # a measurement is no number twice: the torque stays, and the loop goes on
    done = run("./bare_loop", cwd=folder, TRACE="trace", TICKS=1000, BAD_FROM=bad.start, BAD_TO=bad.stop)
    assert done.stdout == "stopped in tick 1000\n"
    rows = trace(folder, 12)
    ctrl.parameters["law.kp"] = 120.0
    begin, python = rows[0, :6], np.zeros((len(rows), 6))
    for k, row in enumerate(rows):
        angle = 1.5 * k * ctrl.dt
        wave = 0.2 * (1.0 - np.cos(angle)), 0.3 * np.sin(angle), 0.45 * np.cos(angle)
        ref = taut.JointMotion(q=begin + wave[0], v=np.full(6, wave[1]), a=np.full(6, wave[2]))
        python[k] = python[k - 1] if k in bad else ctrl.step(row[:6], ref=ref)
    assert_close(rows[:, 6:], python, SINGLE)
    assert np.abs(rows[-1, :6] - begin - wave[0]).max() < 0.05  # it follows
    assert wave[0] > 0.15

    done = run("./bare_loop", cwd=folder, check=False, TRACE="trace", TICKS=1000, BAD_FROM=300, BAD_TO=400)
    assert (done.returncode, done.stdout) == (3, "stopped in tick 302\n")


# -------------------------------------------------------------------- libfranka


def circle(pose: np.ndarray, periods: np.ndarray, stop: int) -> list[taut.TaskMotion]:
    """The reference of torque_control.cpp, after its comments: 5 cm at 0.15 m/s, begun and ended with 0.3 m/s^2."""
    T, radius, angle, rate, out = pose.reshape(4, 4).T, 0.05, 0.0, 0.0, []
    for k, dt in enumerate(periods):
        target = 0.0 if k >= stop else 0.15 / radius
        change = np.clip(target - rate, -6.0 * dt, 6.0 * dt)
        rate += change
        angle += rate * dt
        s, c = np.sin(angle), np.cos(angle)
        inwards, along = np.array([0.0, c, -s]), np.array([0.0, s, c])
        v, a = radius * rate * along, radius * (rate**2 * inwards + (change / dt if dt else 0.0) * along)
        p = T[:3, 3] + radius * (np.array([0.0, 1.0, 0.0]) - inwards)
        turn = np.zeros(3)
        out.append(taut.TaskMotion(pose=taut.Pose(p=p, R=T[:3, :3]), twist=[*v, *turn], acceleration=[*a, *turn]))
    return out


@pytest.mark.long
def test_a_torque_callback_of_libfranka(compilers: tuple[str, str], tmp_path: Path) -> None:
    ctrl = EXPORT["franka"]()
    folder = export(ctrl, tmp_path, "franka", "fr3")
    c, cpp = compilers
    run(c, "-std=c99", "-c", "law/fr3.c", "plant/plant.c", cwd=folder)
    include = ["-Ilaw", "-Iplant", f"-I{HERE}"]
    sources = ["torque_control.cpp", HERE / "robot.cpp", "fr3.o", "plant.o", "-lm"]
    run(cpp, "-std=c++17", *STRICT, *include, "-o", "torque_control", *sources, cwd=folder)

    stop = 2500
    done = run("./torque_control", "172.16.0.2", cwd=folder, TRACE="trace", STOP_AT=stop)
    assert done.stdout == "finished\n"
    rows = trace(folder, 38)
    period, tau = rows[:, 0], rows[:, 31:]
    assert period[0] == 0.0
    assert set(np.round(1e3 * period[1:])) == {1.0, 3.0}  # packets got lost
    ctrl.parameters["law.K"] = [300.0, 400.0, 400.0, 20.0, 20.0, 20.0]
    ctrl.reset(tau_applied=np.full(7, 2.0))  # from which the rate is limited
    references = circle(rows[0, 15:31], period, stop)
    python = [ctrl.step(row[1:8], row[8:15], ref) for row, ref in zip(rows, references, strict=True)]
    assert tau[0] == pytest.approx([1.13] * 4 + [1.88] * 3)
    assert_close(tau, np.array(python), TASK)
    path = rows[:, 27:30] - rows[0, 27:30]
    assert (np.ptp(path, axis=0) > [0.0, 0.08, 0.08]).all()  # it went around
    assert np.abs(path[:, 0]).max() < 0.01
    assert np.abs(rows[-1, 8:15]).max() < 0.02  # and came to rest before it finished

    done = run("./torque_control", "172.16.0.2", cwd=folder, check=False, TRACE="trace", BAD_FROM=700)
    assert (done.returncode, done.stdout) == (1, "cancelled\n")
    assert "not finite" in done.stderr
    assert len(trace(folder, 38)) == 700  # no torque was made of it


# -------------------------------------------------------------------- ros2_control


@pytest.mark.long
def test_a_controller_of_ros2_control(compilers: tuple[str, str], tmp_path: Path) -> None:
    ctrl = EXPORT["ros2_control"]()
    folder = export(ctrl, tmp_path, "ros2_control", "law")
    c, cpp = compilers
    run(c, "-std=c99", "-fPIC", "-c", "law/law.c", "plant/plant.c", cwd=folder)
    words = ["-std=c++17", *STRICT, "-Ilaw", "-Iplant", f"-I{HERE}/ros2"]
    controller = ["-shared", "-fPIC", "-o", "libtaut_controller.so", "src/taut_controller.cpp", "law.o"]
    run(cpp, *words, *controller, "-lm", cwd=folder)
    run(cpp, *words, "-o", "manager", HERE / "manager.cpp", "plant.o", "-ldl", "-lm", cwd=folder)
    run("./manager", "./libtaut_controller.so", cwd=folder, TRACE="trace")

    rows = trace(folder, 18)
    assert len(rows) == 1001
    home, ref, python = rows[0, :6], taut.JointMotion(q=rows[0, :6]), []
    ctrl.parameters["law.kp"] = 120.0
    for k, row in enumerate(rows):
        if k == 1000:  # activated anew
            ctrl.reset()
            ref = taut.JointMotion(q=row[:6])
        elif k >= 100 and k % 100 not in (50, 60):
            angle = 0.002 * (k - 100)
            wave = home + 0.2 * (1.0 - np.cos(angle)), 0.4 * np.sin(angle), 0.8 * np.cos(angle)
            ref = taut.JointMotion(q=wave[0], v=np.full(6, wave[1]), a=np.full(6, wave[2]))
        if k == 500:
            changed = {"law.kp": 250.0, "law.kd": 30.0, "model.payload.mass": 1.5}
            changed |= {"model.payload.com": [0.0, 0.02, 0.1]}
            for path, value in changed.items():
                ctrl.parameters[path] = value
        python.append(ctrl.step(row[:6], row[6:12], ref))
    assert_close(rows[:, 12:], np.array(python), JOINT)
    jump = np.abs(np.diff(rows[498:503, 12:], axis=0)).max()
    assert jump < 0.02 * np.abs(rows[:, 12:]).max()  # the blend took it up


def test_the_package_of_ros_names_what_is_there() -> None:
    folder = EXAMPLES / "ros2_control"
    package = ElementTree.parse(folder / "package.xml").getroot()
    cmake = (folder / "CMakeLists.txt").read_text(encoding="utf-8")
    source = (folder / "src" / "taut_controller.cpp").read_text(encoding="utf-8")
    depends = {node.text for tag in ("depend", "buildtool_depend") for node in package.iter(tag)}
    assert set(re.findall(r"find_package\((\w+) REQUIRED\)", cmake)) == depends
    assert set(re.findall(r'#include "(\w+)/', source)) <= depends
    assert f"project({package.findtext('name')} " in cmake
    library = ElementTree.parse(folder / "taut_controller.xml").getroot()
    plugin = library.find("class")
    assert plugin is not None
    assert f"add_library({library.get('path')} SHARED" in cmake
    assert f"PLUGINLIB_EXPORT_CLASS({plugin.get('type')}, {plugin.get('base_class_type')})" in source
    assert str(plugin.get("name")) in (folder / "config" / "controllers.yaml").read_text(encoding="utf-8")


# -------------------------------------------------------------------- CMake


TARGETS = {
    "franka": {"Franka": "Franka::Franka"},
    "ros2_control": {
        "ament_cmake": "", "rcl_interfaces": "", "trajectory_msgs": "",
        **{name: f"{name}::{name}" for name in (
            "controller_interface", "hardware_interface", "pluginlib", "rclcpp", "rclcpp_lifecycle")},
    },
}  # fmt: skip
OF_AMENT = """
function(ament_package)
endfunction()
function(pluginlib_export_plugin_description_file package file)
  if(NOT EXISTS ${CMAKE_CURRENT_SOURCE_DIR}/${file})
    message(FATAL_ERROR "${file} is not there")
  endif()
endfunction()
"""


@pytest.mark.long
@pytest.mark.parametrize("example", TARGETS)
def test_cmake_builds_it(example: str, tmp_path: Path) -> None:
    if not (shutil.which("cmake") and shutil.which("g++")):
        pytest.skip("needs cmake and g++: apt-get install cmake g++")
    prefix = {"franka": "fr3", "ros2_control": "law"}[example]
    folder = export(EXPORT[example](), tmp_path, example, prefix)
    include = HERE / "ros2" if example == "ros2_control" else HERE
    robot = ""
    if example == "franka":  # the library that libfranka's CMake file would name
        run("g++", "-std=c++17", "-shared", "-fPIC", "-o", "librobot.so", f"-I{HERE}", "-Iplant", HERE / "robot.cpp",
            "-x", "c", "plant/plant.c", "-lm", cwd=folder)  # fmt: skip
        robot = f"target_link_libraries(Franka::Franka INTERFACE {folder}/librobot.so)\n"
    for package, target in TARGETS[example].items():
        made = f"add_library({target} INTERFACE IMPORTED)\n"
        made += f"target_include_directories({target} INTERFACE {include})\n{robot}"
        text = (made if target else "") + (OF_AMENT if package == "ament_cmake" else "")
        (folder / f"{package}Config.cmake").write_text(text, encoding="utf-8")
    known = [f"-D{package}_DIR={folder}" for package in TARGETS[example]]
    run("cmake", "-B", "build", *known, "-DCMAKE_CXX_FLAGS=-Wall -Wextra -Werror", cwd=folder)
    run("cmake", "--build", "build", cwd=folder)
    run("ctest", "--test-dir", "build/law", cwd=folder)
    if example == "franka":
        done = run("build/torque_control", "172.16.0.2", cwd=folder, TRACE="trace", STOP_AT=10)
        assert done.stdout == "finished\n"
    else:
        assert (folder / "build" / "libtaut_controller.so").is_file()
