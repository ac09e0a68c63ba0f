"""Without llvmlite everything runs as plain Python, and says so in one line."""

from __future__ import annotations

import subprocess
import sys

MISSING = "import sys\nsys.modules['llvmlite'] = None  # as where it is not installed\nimport numpy as np, taut\n"
LINE = "llvmlite is not installed, so laws run as plain Python, about 1000 times slower; pip install llvmlite"


def run(code: str, *flags: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *flags, "-c", MISSING + code], capture_output=True, text=True, check=False, timeout=120.0
    )


def test_a_controller_a_native_function_and_a_closed_loop_run() -> None:
    done = run(
        "arm = taut.load_arm('planar2')\n"
        "law = taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=10.0)\n"
        "ctrl = taut.compile(law, arm, limits=taut.Limits(tau=50.0))\n"
        "assert ctrl.engine == 'float'\n"
        "tau = ctrl.step([0.1, 0.2], [0.0, 0.0], taut.JointMotion(q=[0.3, 0.1]))\n"
        "assert np.isfinite(tau).all() and sorted(ctrl.terms) == ['D', 'I', 'P', 'feedforward', 'nonlinear', 'torque_limit']\n"
        "ctrl.parameters['law.kp'] = 150.0\n"
        "bound = ctrl.bind()\n"
        "bound.tick()\n"
        "assert taut.native(lambda a: 2.0 * a, a=2)([1.0, 2.0]).tolist() == [2.0, 4.0]\n"
        "assert taut.math.jacobian(lambda q: q[0] * q[1], [2.0, 3.0]).tolist() == [3.0, 2.0]\n"
        "done = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.3, 0.1]), duration=0.02)\n"
        "assert done.outcome.kind == 'completed', done.outcome\n"
        "print('ran')\n",
        "-W",
        "default",
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "ran"
    lines = [line for line in done.stderr.splitlines() if LINE in line]
    assert lines == [
        f"<string>:6: RuntimeWarning: {LINE}",
        f"<string>:13: RuntimeWarning: {LINE}",
    ]  # the callers' lines


def test_asking_for_native_code_is_refused_in_a_sentence() -> None:
    done = run(
        "try:\n"
        "    taut.compile(taut.laws.PID(kp=1.0), taut.load_arm('planar2'), engine='native')\n"
        "except taut.errors.UsageError as error:\n"
        "    print(error)\n"
    )
    assert done.stdout.strip() == (
        "engine='native' needs llvmlite, which is not installed; pip install llvmlite, or engine='float'"
    )


def test_asking_for_plain_python_says_nothing() -> None:
    done = run("taut.compile(taut.laws.PID(kp=1.0), taut.load_arm('planar2'), engine='float')\n", "-W", "error")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
