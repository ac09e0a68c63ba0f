"""taut design: the command prints what the function finds, and refuses in one sentence."""

from __future__ import annotations

import json

import pytest

import taut
from taut.cli.main import main


def test_the_command_prints_the_report(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "PID", "--arm", "one_joint", "--zeta", "1", "--omega_n", "10"]) == 0
    d = taut.design(taut.laws.PID, taut.load_arm("one_joint"), zeta=1.0, omega_n=10.0)
    assert capsys.readouterr().out == f"{d}\n"


def test_json_has_gains_and_numbers_of_each_pose(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["design", "Impedance", "--arm", "planar2", "--K", "400,20", "--zeta", "0.7", "--json"]
    assert main([*words, "--at", "0.3,0.8", "--at", "[0.3, 1.2]"]) == 0  # all is met
    found = json.loads(capsys.readouterr().out)
    assert found["gains"]["K"] == [400.0] * 3 + [20.0] * 3
    assert [pose["q"] for pose in found["poses"]] == [[0.3, 0.8], [0.3, 1.2]]
    assert {each["name"] for each in found["limits"]} >= {"torque", "rate", "delay", "stiffness"}
    assert found["achieved"][0]["simulated"]["zeta"] == pytest.approx(0.7, abs=0.02)


def test_poses_may_begin_with_a_minus(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["design", "PID", "--arm", "planar2", "--zeta", "1", "--omega_n", "10", "--json"]
    assert main([*words, "--at", "-0.3,0.8", "--at", "-.5,-0.8", "--rate", "500"]) == 1
    assert [pose["q"] for pose in json.loads(capsys.readouterr().out)["poses"]] == [[-0.3, 0.8], [-0.5, -0.8]]


PLANE = '{ kind = "plane", point = [0.0, 0.0, -0.1], normal = [0, 0, 1] }'


def test_a_hybrid_law_gets_what_it_touches_as_scenarios_write_it(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--arm", "gantry3", "--zeta", "1", "--omega_n", "10", "--force", "5"]
    assert main(["design", "HybridMotionForce", *words, "--constraint", PLANE]) == 0
    law = taut.laws.HybridMotionForce(
        constraint=taut.Constraint.plane(point=[0.0, 0.0, -0.1], normal=[0.0, 0.0, 1.0]),
        motion=taut.laws.TaskComputedTorque(kp=1.0, kd=1.0),
    )
    d = taut.design(law, taut.load_arm("gantry3"), zeta=1.0, omega_n=10.0, force=5.0)
    assert capsys.readouterr().out == f"{d}\n"
    assert d.forces[0].designed.omega_n == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["PIDD", "--zeta", "1"], "taut design has no law 'PIDD'; did you mean 'PID'?"),
        (
            ["PID", "--zeta", "one"],
            "--zeta takes a number, or numbers with commas between them, such as --zeta 800,30",
        ),
        (["Impedance", "--K", "-800,30", "--zeta", "1"], "K[0] must be >= 0 [N/m, N m/rad]; got -800.0"),
        (["PID", "--zeta", "-inf", "--omega_n", "5"], "zeta must be finite; got -inf"),
        (["PID", "--zeta", ""], "--zeta takes a number"),
        (["PID", "--zeta", "[1"], "--zeta takes a number"),
        (["Impedance", "--K", "nan,30", "--zeta", "1"], "K[0] must be finite [N/m, N m/rad]; got nan"),
        (["PID", "--zeta", "1", "--omega_n", "inf"], "omega_n must be finite [rad/s]; got inf"),
        (["PID", "--zeta", "nan", "--omega_n", "5"], "zeta must be finite; got nan"),
        (["PID", "--zeta", "1", "--omega_n", "5", "--rate", "nan"], "rate must be finite [Hz]; got nan"),
        (["PID", "--arm", "one_joint", "--zeta", "1"], "PID needs its speed: omega_n, settling or bandwidth"),
        (
            ["HybridMotionForce", "--zeta", "1"],
            'HybridMotionForce needs what it touches: --constraint \'{ kind = "plane", point = ',
        ),
        (["HybridMotionForce", "--constraint", "{ kind = "], "--constraint is no valid TOML"),
        (["HybridMotionForce", "--constraint", '{ kind = "plan" }'], "--constraint: [constraint]"),
        (["PID", "--constraint", "{}"], "--constraint has no meaning for PID, which holds to none; leave it out"),
        (["PID", "--zeta", "1", "--omega_n", "5", "--at", "0,0"], "at must be one pose (7,) or several (k, 7)"),
    ],
)
def test_a_wrong_request_is_one_sentence_and_status_2(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", *words]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert len(err.strip().splitlines()) == 1
