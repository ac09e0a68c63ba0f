"""The page "Choose a law": every line of its tables makes a law that runs on the arm that the page names."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

import taut

PAGE = (Path(__file__).parents[2] / "docs" / "choose.md").read_text(encoding="utf-8")
DRIVES = ("Velocities", "Positions")  # the page's headings for arms whose drives close these loops
LINE = re.compile(r"^\|[^|`]*\| `((?:laws|taut)\.[^`]*(?:\)|\.law))`", re.MULTILINE)


def lines() -> list[tuple[str, str]]:
    """Heading and code of each row."""
    parts = re.split(r"^## (.*)$", PAGE, flags=re.MULTILINE)
    named = zip(parts[1::2], parts[2::2], strict=True)
    return [(heading, code) for heading, text in named for code in LINE.findall(text) if "..." not in code]


def test_the_page_has_a_line_for_every_kind_of_robot() -> None:
    headings = [heading for heading, _ in lines()]
    assert len(headings) == 32
    assert set(headings) >= {"Torques: free motion", "Torques: contact", *DRIVES}


@pytest.mark.part(1)
@pytest.mark.parametrize(("heading", "code"), lines(), ids=lambda text: text[:60])
def test_a_line_of_the_page_makes_a_law_that_runs(heading: str, code: str) -> None:
    arm = taut.load_arm("ur10" if heading in DRIVES else "panda")
    law = eval(code, {"taut": taut, "laws": taut.laws, "arm": arm})
    ctrl = taut.compile(law, arm, engine="float")
    at_home = {
        taut.TaskMotion: taut.TaskMotion(pose=taut.snapshot(arm, arm.home).T()),
        taut.TaskForce: taut.TaskForce(F_app=[0.0, 0.0, -5.0, 0.0, 0.0, 0.0]),
        taut.JointMotion: taut.JointMotion(q=arm.home),
    }
    force = {"F_app": [0.0, 0.0, -5.0, 0.0, 0.0, 0.0]} if "AppliedWrench" in code else {"press": 5.0}
    at_home |= {type(held): held for held in [taut.pressing(at_home[taut.TaskMotion], **force)]}
    wrist = np.zeros(6) if "F_ext" in ctrl.needs else None
    command = ctrl.step(arm.home, np.zeros(arm.n), at_home[law.reference], F_ext=wrist)
    assert np.isfinite(command).all()
    assert ctrl.kind == {"Velocities": "velocity", "Positions": "position"}.get(heading, "torque")


WHOLE = bool(os.environ.get("TAUT_BARS"))  # `make bars`
LIGHT = ("ur10", "xarm7")  # arms with the lightest last joints
ALL = ("panda", "fr3", "z1", "kinova", "ur3", "ur5", *LIGHT)
OF_ONE_JOINT = re.compile(r"laws\.PID\(")  # whose gains are for one_joint, as the page states
TOUCHING = taut.environments.Push(peak=[0.0, 0.0, 0.0])  # nothing, but the wrench is measured


@pytest.mark.part(1)
@pytest.mark.bars
@pytest.mark.parametrize(
    "code", [code for heading, code in lines() if heading not in DRIVES], ids=lambda text: text[:60]
)
def test_the_gains_of_a_line_are_stable_on_every_arm(code: str) -> None:
    names = ("one_joint",) if OF_ONE_JOINT.search(code) else ALL if WHOLE else LIGHT[1:]
    for name in names:
        arm = taut.load_arm(name)
        for friction in ("arm", None) if WHOLE and "Hybrid" not in code else (None,):
            if "null=" in code and arm.n < 7:  # a null space that an arm of six joints does not have
                continue
            if "FrictionCompensation" in code and not arm.friction.dry:
                arm = arm.with_friction(taut.Friction(viscous=0.1, coulomb=0.1))
            law = eval(code, {"taut": taut, "laws": taut.laws, "arm": arm})
            ctrl = taut.compile(law, arm)
            plant = taut.RigidPlant(arm, friction=friction, environment=TOUCHING if "F_ext" in ctrl.needs else None)
            found = taut.run(ctrl, plant, duration=2.0 / ctrl.rate).info.stability
            assert found.stable is not False, (name, friction, found.message)
