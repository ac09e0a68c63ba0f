"""Make tests/control/peer_vectors.json: states of a Panda, and the torques that other libraries give there.

Each step reads the file and writes its own part, so that each runs where its library is:

    python tests/control/make_peer_vectors.py states       # an environment with taut
    python tests/control/make_peer_vectors.py robosuite    # one with robosuite
    python tests/control/make_peer_vectors.py newton       # one with newton, on the CPU: what Isaac Lab's controller calls
    python tests/control/make_peer_vectors.py franky       # one with franky-control: its defaults, which is what it says offline
"""

import importlib
import importlib.metadata
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

FILE = Path(__file__).with_name("peer_vectors.json")
SPREAD = 0.4  # [rad] of the joints about home
ARRAYS = ("q", "v", "q_rest", "p", "R", "p_des", "R_des", "M", "J", "h", "g")


def states() -> list[dict[str, Any]]:
    """Five states and targets; the first rests at home."""
    taut: Any = importlib.import_module("taut")
    spatial: Any = importlib.import_module("taut.maths.spatial")
    arm, random = taut.load_arm("panda"), np.random.default_rng(10)
    out = []
    for k in range(5):
        moves = k > 0
        q = arm.home + moves * random.uniform(-SPREAD, SPREAD, arm.n)
        v = moves * random.uniform(-0.5, 0.5, arm.n)
        x = taut.snapshot(arm, q, v)
        T, turn = x.T(), spatial.rotation_exp(random.uniform(-0.3, 0.3, 3))
        values = {"q": q, "v": v, "q_rest": arm.home, "p": T.p, "R": T.R}
        values |= {"p_des": T.p + random.uniform(-0.05, 0.05, 3), "R_des": np.asarray(turn) @ T.R}
        values |= {"M": x.M, "J": x.J(), "h": x.h, "g": x.g}
        out.append({name: np.asarray(values[name]).tolist() for name in ARRAYS})
    return out


def robosuite(given: list[dict[str, Any]]) -> dict[str, Any]:
    """Its OperationalSpaceController at its defaults, its state set by hand in place of a simulation."""
    osc: Any = importlib.import_module("robosuite.controllers.parts.arm.osc")
    tools: Any = importlib.import_module("robosuite.utils.control_utils")

    def controller(uncouple: bool, s: dict[str, Any]) -> Any:
        class Held(osc.OperationalSpaceController):  # type: ignore[misc, name-defined]
            def __init__(self) -> None:
                self.kp = np.full(6, 150.0)
                self.kd = 2.0 * np.sqrt(self.kp) * 1.0
                self.uncoupling, self.use_ori, self.input_ref_frame = uncouple, True, "world"
                self.interpolator_pos = self.interpolator_ori = None
                self.naming_prefix = self.part_name = ""
                self.goal_pos, self.goal_ori = s["p_des"], s["R_des"]
                self.ref_pos, self.ref_ori_mat = s["p"], s["R"]
                self.J_full, self.J_pos, self.J_ori = s["J"], s["J"][:3].copy(), s["J"][3:].copy()
                twist = s["J"] @ s["v"]
                self.ref_pos_vel, self.ref_ori_vel = twist[:3], twist[3:]
                self.mass_matrix, self.initial_joint = s["M"], s["q_rest"]
                self.joint_pos, self.joint_vel = s["q"], s["v"]
                self.qvel_index = np.arange(7)
                still = SimpleNamespace(
                    qfrc_bias=s["h"], get_site_xvelp=lambda _: np.zeros(3), get_site_xvelr=lambda _: np.zeros(3)
                )
                self.sim = SimpleNamespace(data=still)

            def update(self, force: bool = False) -> None:
                """The state is given."""

        return Held()

    rows = []
    for state in given:
        s = {name: np.ascontiguousarray(value, dtype=np.float64) for name, value in state.items()}
        null_space = tools.opspace_matrices(s["M"], s["J"], s["J"][:3].copy(), s["J"][3:].copy())[3]
        null = tools.nullspace_torques(s["M"], null_space, s["q_rest"], s["q"], s["v"])
        row = {
            "full": controller(False, s).run_controller(),
            "uncoupled": controller(True, s).run_controller(),
            "null": null,
            "orientation_error": tools.orientation_error(s["R_des"], s["R"]),
        }
        rows.append({name: np.asarray(value).tolist() for name, value in row.items()})
    return {"version": importlib.metadata.version("robosuite"), "rows": rows}


def newton(given: list[dict[str, Any]]) -> dict[str, Any]:
    """Its model-free operational-space controller, with the gains that Isaac Lab makes of its defaults."""
    wp: Any = importlib.import_module("warp")
    controllers: Any = importlib.import_module("newton.controllers")
    wp.config.quiet = True

    def torque(s: dict[str, Any], full: bool, partial: bool, null: bool) -> list[float]:
        made = controllers.ControllerOperationalSpaceModelFree(
            controlled_dofs_per_robot=wp.full(1, 7, dtype=wp.int32, device="cpu"),
            motion_stiffness=100.0,
            motion_damping=20.0,
            use_inertia_decoupling=full or partial,
            use_partial_inertia_decoupling=partial,
            use_gravity_compensation=True,
            use_null_space_control=null,
            null_space_stiffness=10.0 if null else None,
            null_space_damping=2.0 * 10.0**0.5 if null else None,
            device="cpu",
        )
        i, o = made.input(), made.output()

        def put(name: str, value: Any) -> None:
            port = getattr(i, name)
            port.assign(np.asarray(value, dtype=np.float32).reshape(port.numpy().shape))

        put("tool_pose_world", [*s["p"], *_quaternion(s["R"])])
        put("desired_tool_pose_operational", [*s["p_des"], *_quaternion(s["R_des"])])
        put("tool_twist_world", s["J"] @ s["v"])
        put("jacobian_tool_world", s["J"])
        put("gravity_force", s["g"])
        if full or partial:
            put("mass_matrix", s["M"])
        if null:
            put("joint_q", s["q"])
            put("joint_qd", s["v"])
            put("joint_q_des_null", s["q_rest"])
        made.step(inputs=i, outputs=o, dt=0.0)
        out: list[float] = o.joint_f.numpy().astype(float).tolist()
        return out

    rows = []
    for state in given:
        s = {name: np.asarray(value) for name, value in state.items()}
        rows.append(
            {
                "decoupled": torque(s, full=True, partial=False, null=True),
                "partial": torque(s, full=False, partial=True, null=False),
                "plain": torque(s, full=False, partial=False, null=False),
                "plain_null": torque(s, full=False, partial=False, null=True),
            }
        )
    return {"version": importlib.metadata.version("newton"), "rows": rows}


def franky() -> dict[str, Any]:
    """Its default gains; its laws run in the loop of a robot only."""
    module: Any = importlib.import_module("franky")
    gains = module.CartesianImpedanceGains()
    isotropic = module.CartesianImpedanceGains.isotropic(1200.0, 80.0)
    return {
        "version": importlib.metadata.version("franky-control"),
        "stiffness": np.asarray(gains.stiffness).tolist(),
        "isotropic": np.asarray(isotropic.stiffness).tolist(),
    }


def _quaternion(R: Any) -> list[float]:
    """(4,) x, y, z, w of a rotation of less than half a turn about any axis but one that makes w zero."""
    K = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    S = np.zeros((4, 4))
    S[:3, :3] = R + R.T - np.trace(R) * np.eye(3)
    S[:3, 3] = S[3, :3] = K
    S[3, 3] = np.trace(R)
    values, vectors = np.linalg.eigh(S)
    q = vectors[:, int(np.argmax(values))]
    return [float(part) for part in q]


def main(step: str) -> None:
    """Run one step."""
    told = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    if step == "states":
        told = {"states": states()}
    elif step == "franky":
        told["franky"] = franky()
    else:
        told[step] = {"robosuite": robosuite, "newton": newton}[step](told["states"])
    FILE.write_text(json.dumps(told) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
