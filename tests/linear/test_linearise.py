"""Linear models of loops: against closed forms, sampled predictions, differences of native code, runs, python-control."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import fsolve

import taut
from taut.base.types import Float64Array
from taut.codegen.engine import Steps
from taut.codegen.loop import StepLoop
from taut.codegen.program import Block
from taut.linear.linearise import rest_of
from taut.linear.performance import powers, scaled_norm
from taut.linear.period import loop_map
from taut.loop import DT

control = pytest.importorskip("control")
laws, Plant = taut.laws, taut.RigidPlant
EXACT = 1e-12
FIT = 0.005  # of a pole fitted from a run


def loop_of(
    law: taut.Law, arm: taut.Arm, plant: taut.RigidPlant | None = None, ref: object = None, **options: object
) -> taut.Loop:
    ctrl = taut.compile(law, arm, **options)  # type: ignore[arg-type]
    return taut.Loop(ctrl, plant or Plant(arm, friction=None), ref, duration=0.5)


def sorted_poles(poles: Float64Array) -> Float64Array:
    return np.sort_complex(np.round(poles, 13))


def weightless(name: str) -> taut.Arm:
    return taut.load_arm(name, gravity=(0.0, 0.0, 0.0))


# -------------------------------------------------------------------- closed forms


@pytest.mark.parametrize("substeps", [1, 4])
def test_computed_torque_of_one_joint_is_the_exact_discrete_second_order(substeps: int) -> None:
    kp, kd, dt = 100.0, 20.0, 1e-3
    arm = weightless("one_joint")
    lin = taut.linearise(
        loop_of(laws.ComputedTorque(kp=kp, kd=kd), arm, Plant(arm, friction=None, substeps=substeps))
    )
    h = dt / substeps
    step = np.array([[1.0, h, h * h], [0.0, 1.0, h], [0.0, 0.0, 1.0]])  # q, v and a held acceleration
    held = np.linalg.matrix_power(step, substeps)[:2]
    A = held[:, :2] + np.outer(held[:, 2], [-kp, -kd])
    assert lin.states == ("plant.q[0]", "plant.v[0]")
    assert pytest.approx(A, abs=EXACT) == lin.A
    B = lin.B[:, [lin.columns(f"ref.{name}")[0] for name in ("q", "v", "a")]]
    assert pytest.approx(np.outer(held[:, 2], [kp, kd, 1.0]), abs=EXACT) == B
    M = float(taut.snapshot(arm, arm.home).M[0, 0])
    for name in ("disturbance.torque", "disturbance.command"):
        assert lin.B[:, lin.columns(name)[0]] == pytest.approx(held[:, 2] / M, rel=EXACT)
    assert lin.C[lin.rows("command")[0]] == pytest.approx([-kp * M, -kd * M], rel=EXACT)
    assert lin.D[lin.rows("command")[0], lin.columns("ref.a")[0]] == pytest.approx(M, rel=EXACT)


def test_a_gantry_is_three_single_joints() -> None:
    """Section 10.2.2.1: axes at right angles know nothing of each other."""
    arm = taut.load_arm("gantry3")
    kp, kd, ki = np.array([3e3, 2e3, 1e3]), np.array([200.0, 150.0, 60.0]), np.array([500.0, 0.0, 300.0])
    lin = taut.linearise(loop_of(laws.GravityPID(kp=kp, kd=kd, ki=ki), arm))
    mass, dt = np.diag(taut.snapshot(arm, arm.home).M), 1e-3
    index = {name: i for i, name in enumerate(lin.states)}
    for j in range(3):
        names = [f"plant.q[{j}]", f"plant.v[{j}]", f"law.integral.e_int[{j}]"]
        if not ki[j]:
            names = names[:2]
            assert lin.point.left_out[f"law.integral.e_int[{j}]"] == "nothing depends on it"
        rows = [index[name] for name in names]
        # The integral of a tick counts in that tick: e+ = e - dt q, tau = -kp q - kd v + ki e+.
        tau = np.array([-kp[j] - ki[j] * dt, -kd[j], ki[j]]) / mass[j]
        v = np.array([0.0, 1.0, 0.0]) + dt * tau
        single = np.array([np.array([1.0, 0.0, 0.0]) + dt * v, v, [-dt, 0.0, 1.0]])
        assert lin.A[np.ix_(rows, rows)] == pytest.approx(single[: len(rows), : len(rows)], abs=EXACT)
        others = [i for i in range(len(lin.states)) if i not in rows]
        assert np.abs(lin.A[np.ix_(rows, others)]).max() == 0.0


@pytest.mark.parametrize("velocity", ["measured", "difference", "filtered", "low-pass"])
@pytest.mark.parametrize("delay", [0, 2])
def test_poles_are_those_of_the_sampled_prediction(velocity: str, delay: int) -> None:
    kp, kd, b = 40.0, 3.0, 0.4
    kinds = {
        "measured": ("measured", None),
        "difference": ("difference", "difference"),
        "filtered": (taut.sensors.Difference(cutoff=80.0), taut.sensors.Difference(cutoff=80.0)),
        "low-pass": (taut.sensors.LowPass(cutoff=80.0, order=2), taut.sensors.LowPass(cutoff=80.0, order=2)),
    }
    predicted, sensing = kinds[velocity]
    arm = weightless("one_joint").with_friction(taut.Friction(viscous=b))
    plant = Plant(arm, integrator="rk4", actuation=taut.drives.Actuation(delay=delay * 1e-3))
    options = {} if sensing is None else {"sensing": taut.Sensing(velocity=sensing)}
    lin = taut.linearise(loop_of(laws.PID(kp=kp, kd=kd), arm, plant, **options))
    sampled = taut.error_dynamics(
        M=float(taut.snapshot(arm, arm.home).M[0, 0]), b=b, kp=kp, kd=kd, rate=1000.0, delay=delay * 1e-3,
        velocity=predicted,
    )  # fmt: skip
    slow, wanted = lin.poles[np.abs(lin.poles) > 1e-3], sampled.poles[np.abs(sampled.poles) > 1e-3]
    assert len(slow) == len(wanted)
    for z in wanted:
        assert np.abs(slow - z).min() < 1e-9
    assert lin.stable == sampled.stable


# -------------------------------------------------------------------- a rich loop of seven joints


@pytest.fixture(scope="module")
def rich() -> taut.Loop:
    """An admittance on computed torque: delay, drives with a lag, filters, a payload, four steps in a period."""
    arm = taut.load_arm("panda")
    law = laws.Admittance(
        D=(5.0, 0.1), B=(100.0, 3.0), K=(500.0, 30.0), inner=laws.TaskComputedTorque(kp=400.0, kd=40.0, ki=10.0)
    )
    plant = Plant(
        arm.with_payload(0.5), friction=None, substeps=4, environment=taut.environments.Push(),
        actuation=taut.drives.Actuation(delay=1e-3, bandwidth=800.0),
    )  # fmt: skip
    sensing = taut.Sensing(velocity=taut.sensors.Difference(cutoff=60.0))
    ctrl = taut.compile(law, arm, sensing=sensing)
    return taut.Loop(ctrl, plant, duration=0.05)


@pytest.fixture(scope="module")
def rich_model(rich: taut.Loop) -> taut.LinearSystem:
    return taut.linearise(rich)


def test_the_derivative_is_that_of_the_native_kernel(rich: taut.Loop, rich_model: taut.LinearSystem) -> None:
    """Central differences of the kernel that runs use: code that knows nothing of derivatives."""
    made = loop_map(rich)
    found = rest_of(rich, made, None, 0.5)
    inputs, parameters = Block.of(rich.input_shapes()), Block.of(rich.parameter_shapes())
    row, values = found.at.inputs[: inputs.size].copy(), parameters.pack({**rich.parameters, DT: rich.dt})
    blocks, example = (inputs, parameters, made.memory), (row, values, found.at.memory)
    steps = Steps(rich.step, *blocks, rich.substep, rich.plant.substeps - 1)
    kernel = StepLoop(steps, example, engine="native")

    def after(memory: Float64Array, given: Float64Array) -> Float64Array:
        new = memory.copy()
        assert kernel.run(given[np.newaxis], values, new, np.zeros((1, kernel.outputs.size))) == 1
        return new

    states, ins = made.state_coordinates, made.input_coordinates
    kept = [states.names.index(name) for name in rich_model.states]
    scale = np.abs(rich_model.A).max()
    h = 1e-5
    ways = states.basis(found.at.memory)
    for column, i in enumerate(kept):
        ends = [after(found.at.memory + s * h * ways[i], row) for s in (1.0, -1.0)]
        slope = states.read(found.memory, (ends[0] - ends[1])[np.newaxis] / (2.0 * h))[0, kept]
        assert slope == pytest.approx(rich_model.A[:, column], abs=1e-6 * scale), rich_model.states[column]
    ways = ins.basis(found.at.inputs)[:, : inputs.size]
    for name in ("ref.p[0]", "ref.rotation[2]", "ref.twist[1]"):
        ends = [after(found.at.memory, row + s * h * ways[ins.names.index(name)]) for s in (1.0, -1.0)]
        slope = states.read(found.memory, (ends[0] - ends[1])[np.newaxis] / (2.0 * h))[0, kept]
        column = rich_model.B[:, rich_model.columns(name)[0]]
        assert slope == pytest.approx(column, abs=1e-6 * max(1.0, np.abs(column).max())), name


def test_all_memory_is_in_the_model(rich_model: taut.LinearSystem) -> None:
    heads = {name.partition("[")[0] for name in rich_model.states}
    assert {"plant.q", "plant.v", "plant.motor", "plant.delay", "law.rotation", "law.inner.integral.e_int"} <= heads
    assert any(head.startswith("sensing.velocity") for head in heads)
    assert rich_model.stable
    assert rich_model.point.branches == ()


def test_what_the_tool_does_is_the_jacobian_of_what_the_joints_do(rich_model: taut.LinearSystem) -> None:
    J = taut.snapshot(taut.load_arm("panda"), rich_model.point.q).J()
    q, v = ([rich_model.states.index(f"plant.{name}[{i}]") for i in range(7)] for name in ("q", "v"))
    C = rich_model.C
    pose = [*rich_model.rows("tip.p"), *rich_model.rows("tip.rotation")]
    assert C[np.ix_(pose, q)] == pytest.approx(J, abs=EXACT)
    assert C[np.ix_(list(rich_model.rows("tip.twist")), v)] == pytest.approx(J, abs=EXACT)


def test_plain_python_gives_the_same_model() -> None:
    arm, law = taut.load_arm("planar2"), laws.ComputedTorque(kp=100.0, kd=20.0, ki=10.0)
    plant = Plant(arm, friction=None, substeps=3, actuation=taut.drives.Actuation(delay=1e-3))
    one, other = (
        taut.linearise(loop_of(law, arm, plant, engine=engine), at=[0.3, 0.5]) for engine in ("native", "float")
    )
    assert one.states == other.states
    for name in "ABCD":
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-11)


def test_noise_comes_in_as_the_sensor_has_it() -> None:
    arm, kp, noise = weightless("one_joint"), 40.0, 3e-4
    plant = Plant(arm, friction=None, sensors=taut.sensors.Sensors(position=taut.sensors.Encoder(noise=noise)))
    lin = taut.linearise(loop_of(laws.PID(kp=kp, kd=3.0), arm, plant))
    column = next(name for name in lin.inputs if name.startswith("noise."))
    assert lin.D[lin.rows("command")[0], lin.columns(column)[0]] == pytest.approx(-kp * noise, rel=EXACT)
    steady = lin.frequency_response(0.0, input=column, output="q[0]")[0]
    assert steady == pytest.approx(-noise, rel=1e-9)  # a constant error of the encoder is one of the joint


# -------------------------------------------------------------------- the equilibrium


def test_a_law_without_gravity_sags_to_where_its_spring_holds_the_weight() -> None:
    arm, kp, at = taut.load_arm("planar2"), 100.0, np.array([0.3, 0.5])
    lin = taut.linearise(loop_of(laws.PID(kp=kp, kd=20.0), arm), at=at)
    held = fsolve(lambda q: kp * (at - q) - taut.snapshot(arm, q).g, at)
    assert lin.point.q == pytest.approx(held, abs=1e-9)
    assert lin.point.moved == pytest.approx(held - at, abs=1e-9)
    assert {"law.integral.e_int[0]", "law.integral.e_int[1]"} <= {*lin.point.left_out}  # with ki = 0 it grows


def test_an_integral_ends_at_the_reference_with_the_weight_in_it() -> None:
    arm, at = taut.load_arm("planar2"), np.array([0.3, 0.5])
    loop = loop_of(laws.PID(kp=100.0, kd=20.0, ki=50.0), arm)
    lin = taut.linearise(loop, at=at)
    assert np.abs(lin.point.moved).max() < 1e-9
    made = loop_map(loop)
    e_int = made.memory.views(rest_of(loop, made, at, 0.5).at.memory)["law.integral.e_int"]
    assert e_int == pytest.approx(taut.snapshot(arm, at).g / 50.0, rel=1e-9)


# -------------------------------------------------------------------- runs


def test_poles_fitted_from_a_decaying_run_are_the_predicted_ones() -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(laws.GravityPID(kp=[60.0, 30.0], kd=[4.0, 1.0]), arm)
    at = np.array([0.4, -0.7])
    loop = taut.Loop(ctrl, Plant(arm, friction=None), taut.JointMotion(q=at), duration=1.0)
    lin = taut.linearise(loop, at=at)
    x0 = np.array([2e-4, -1e-4, 0.0, 0.0])
    run = taut.run(loop, q0=at + x0[:2])
    rows = np.hstack([run.q - at, run.v])
    A, *_ = np.linalg.lstsq(rows[:-1], rows[1:], rcond=None)
    fitted, wanted = (np.log(np.sort_complex(z)) / lin.dt for z in (np.linalg.eigvals(A), lin.poles))
    assert len(np.unique(np.round(wanted, 3))) == 4
    assert np.abs(fitted - wanted).max() < FIT * np.abs(wanted).min()
    for i, row in enumerate(lin.rows("q")):
        free = powers(lin.C[row], lin.A, len(run)) @ x0
        assert free == pytest.approx(run.q[:, i] - at[i], abs=1e-3 * x0[0])


# -------------------------------------------------------------------- kinks


def test_steps_count_by_their_mean_slope() -> None:
    arm = taut.load_arm("planar2")
    rough = Plant(
        arm, friction=None, sensors=taut.sensors.Sensors(position=taut.sensors.Encoder(resolution=1e-4)),
        actuation=taut.drives.Actuation(resolution=0.01),
    )  # fmt: skip
    law, at = laws.GravityPID(kp=100.0, kd=20.0), [0.3, 0.5]
    options = {"sensing": taut.Sensing(velocity="difference")}
    stepped, plain = (taut.linearise(loop_of(law, arm, plant, **options), at=at) for plant in (rough, None))
    assert stepped.states == plain.states
    assert pytest.approx(plain.A, abs=1e-9) == stepped.A
    for path in ("actuation.resolution", "sensors.position.resolution"):
        assert any(path in sentence for sentence in stepped.point.branches)


def test_a_joint_at_its_limit_is_told_and_hangs_without_control() -> None:
    arm = taut.load_arm("planar2")
    plant = Plant(arm.with_payload(0.3), friction=None)
    loop = loop_of(laws.GravityPID(kp=100.0, kd=20.0), arm, plant, limits=taut.Limits(tau=[25.0, 1000.0]))
    lin = taut.linearise(loop, at=[0.0, 0.0])
    assert [text for text in lin.point.branches if text.startswith("joint 'joint1' is at its torque limit")]
    row = lin.C[lin.rows("command")[0]]
    assert np.abs(row).max() == 0.0


def test_a_joint_that_sticks_is_told_and_does_not_move() -> None:
    arm = weightless("one_joint").with_friction(taut.Friction(coulomb=1.0))
    lin = taut.linearise(loop_of(laws.PID(kp=10.0, kd=1.0), arm, Plant(arm)))
    assert any("joint 'joint1' (stiction)" in sentence for sentence in lin.point.branches)
    loop = loop_of(laws.PID(kp=10.0, kd=1.0), arm, Plant(arm))
    loop.parameters["plant.friction.coulomb"] = 0.0
    assert taut.linearise(loop).point.branches == ()  # as its parameters are now
    assert pytest.approx(np.array([[1.0, 0.0], [0.0, 0.0]]), abs=1e-12) == lin.A
    assert lin.stable
    assert "nan" not in str(lin)
    (joint,) = lin.margins().signals
    assert (joint.signal, joint.gain, joint.phase, joint.delay) == ("joint1", (0.0, np.inf), np.inf, np.inf)


def test_what_drifts_is_told_as_that_and_what_grows_as_that() -> None:
    arm = weightless("one_joint")
    free = taut.linearise(loop_of(laws.GravityCompensation(kd=0.0), arm, Plant(arm, friction=None)))
    assert not free.stable
    assert free.unstable_because.startswith("marginally stable")
    assert free.unstable_because in free.content().faults
    stiff = taut.linearise(loop_of(laws.PID(kp=1e7, kd=1.0), arm, Plant(arm, friction=None)))
    assert f"{stiff.radius:.6g}" in stiff.unstable_because
    assert taut.linearise(loop_of(laws.PID(kp=10.0, kd=1.0), arm, Plant(arm, friction=None))).stable


def test_the_two_sides_of_a_wall_are_told() -> None:
    arm = weightless("gantry3")
    tip = taut.snapshot(arm, arm.home).T().p
    wall = taut.environments.StiffWall(point=tip, normal=[0.0, 0.0, 1.0], stiffness=1000.0)
    lin = taut.linearise(loop_of(laws.PID(kp=500.0, kd=50.0), arm, Plant(arm, friction=None, environment=wall)))
    assert any("non-smooth in plant.q" in text for text in lin.point.branches)
    away = taut.linearise(
        loop_of(laws.PID(kp=500.0, kd=50.0), arm, Plant(arm, friction=None, environment=wall)), at=arm.home + 0.1
    )
    assert away.point.branches == ()


def test_via_joint_space_is_the_law_that_it_holds_about_where_its_reference_rests() -> None:
    """What it takes the length of is zero there, and has no derivative: an error that is solved, to the last bit."""
    arm = taut.load_arm("planar3")
    inner = laws.ComputedTorque(kp=100.0, kd=20.0)
    held, alone = (taut.linearise(loop_of(law, arm)) for law in (taut.via_joint_space(inner), inner))
    for name in ("disturbance.torque", "disturbance.wrench"):
        mine, own = (lin.frequency_response(30.0, input=name, output="q")[0] for lin in (held, alone))
        assert mine == pytest.approx(own, rel=1e-9, abs=1e-15)
    assert held.point.branches == ()
    follows = held.frequency_response(0.0, input="ref.p", output="tip.p")[0]
    assert follows[np.ix_([0, 2], [0, 2])] == pytest.approx(np.eye(2), abs=1e-9)


# -------------------------------------------------------------------- margins, python-control


@pytest.fixture(scope="module")
def late() -> taut.LinearSystem:
    """One joint with a delay, a filter and an integral."""
    arm = weightless("one_joint").with_friction(taut.Friction(viscous=0.1))
    plant = Plant(arm, substeps=4, actuation=taut.drives.Actuation(delay=2e-3, bandwidth=300.0))
    options = {"sensing": taut.Sensing(velocity=taut.sensors.Difference(cutoff=80.0))}
    return taut.linearise(loop_of(laws.PID(kp=40.0, kd=3.0, ki=20.0), arm, plant, **options))


def test_margins_are_those_of_python_control(late: taut.LinearSystem) -> None:
    row, column = late.C[list(late.rows("command"))], late.B[:, list(late.columns("disturbance.command"))]
    opened = control.ss(late.A - column @ row, column, -row, 0.0, late.dt)  # the command no longer acts
    omega = np.logspace(-2, np.log10(np.pi / late.dt), 4000)
    known = control.frd(np.ravel(control.frequency_response(opened, omega).complex), omega, smooth=True, dt=late.dt)
    gains, phases, _, _, at_phase, _ = control.stability_margins(known, returnall=True)
    mine = late.margins().signals[0]
    above = min(gain for gain in gains if gain > 1.0)
    below = max([gain for gain in gains if 1e-6 < gain < 1.0], default=0.0)
    assert mine.gain == pytest.approx((below, above), rel=1e-3, abs=1e-6)
    k = int(np.argmin(np.abs(phases)))
    assert mine.phase == pytest.approx(abs(phases[k]), rel=1e-4)
    assert mine.crossover == pytest.approx(at_phase[k], rel=1e-4)
    assert mine.delay == pytest.approx(np.radians(phases[k]) / at_phase[k], rel=1e-4)
    alpha = control.disk_margins(opened, omega, skew=0.0)[0]
    assert late.margins().disk.alpha == pytest.approx(float(alpha), rel=1e-3)


def test_the_loop_turns_unstable_at_its_gain_margin() -> None:
    arm = weightless("one_joint").with_friction(taut.Friction(viscous=0.1))
    plant = Plant(arm, substeps=4, actuation=taut.drives.Actuation(delay=2e-3))
    loop = loop_of(laws.PID(kp=40.0, kd=3.0, ki=20.0), arm, plant)
    most = taut.linearise(loop).margins().signals[0].gain[1]
    for factor, stable in ((0.999, True), (1.001, False)):
        for path, value in (("law.kp", 40.0), ("law.kd", 3.0), ("law.ki", 20.0)):
            loop.parameters[path] = most * factor * value
        lin = taut.linearise(loop)
        assert lin.stable is stable
        assert (lin.margins().disk.alpha > 0.0) is stable


def test_one_joint_is_broken_while_the_others_stay_closed() -> None:
    """Of two joints: 1 + L_1 = det(I + L) / det of what is left, from the model without its loops."""
    arm = taut.load_arm("planar2")
    lin = taut.linearise(loop_of(laws.GravityPID(kp=[60.0, 30.0], kd=[4.0, 1.0]), arm), at=[0.4, -0.7])
    omega = np.array([1.0, 10.0, 100.0])
    command, torque = list(lin.rows("command")), list(lin.columns("disturbance.command"))
    B, C = lin.B[:, torque], lin.C[command]
    opened = lin.A - B @ C  # the command no longer acts
    for w in omega:
        z = np.exp(1j * w * lin.dt)
        L = -C @ np.linalg.solve(z * np.eye(4) - opened, B)
        left = 1.0 + L[1, 1]
        S = lin.sensitivity(w, input="disturbance.command[0]", output="command[0]")[0, 0, 0]
        assert pytest.approx(1.0 / S, rel=1e-9) == np.linalg.det(np.eye(2) + L) / left


def test_the_bound_of_the_structured_singular_value_is_tight_where_it_is_known() -> None:
    random = np.random.default_rng(0)
    diagonal = np.diag([1.0, -3.0j, 2.0])
    scales = np.diag([1.0, 100.0, 1e-3])
    hidden = scales @ diagonal @ np.linalg.inv(scales)
    triangular = np.array([[0.5, 1e4], [0.0, 0.7]])
    bounds = scaled_norm(np.array([hidden, diagonal], dtype=np.complex128))
    assert bounds == pytest.approx([3.0, 3.0])
    assert scaled_norm(triangular[np.newaxis].astype(complex))[0] >= 0.7
    M = random.normal(size=(3, 3)) + 1j * random.normal(size=(3, 3))
    bound = scaled_norm(M[np.newaxis])[0]
    for _ in range(300):  # no unitary diagonal makes the spectral radius larger
        U = np.diag(np.exp(2j * np.pi * random.random(3)))
        assert np.abs(np.linalg.eigvals(U @ M)).max() <= bound * (1.0 + 1e-9)


def test_python_control_has_the_same_poles_and_responses(late: taut.LinearSystem) -> None:
    system = late.to_control()
    assert system.dt == late.dt
    assert np.sort(np.abs(system.poles())) == pytest.approx(np.sort(np.abs(late.poles)), abs=1e-9)
    omega = np.array([0.1, 3.0, 200.0])
    theirs = control.frequency_response(system["q[0]", "disturbance_torque[0]"], omega).complex
    mine = late.frequency_response(omega, input="disturbance.torque[0]", output="q[0]")
    assert np.ravel(theirs) == pytest.approx(mine, rel=1e-9)


def test_at_a_pole_a_response_is_infinite_or_its_limit() -> None:
    """One joint without a spring: torque drives it for ever, and its speed settles at tau / kd."""
    arm, kd = weightless("one_joint"), 2.0
    push = {"input": "disturbance.torque[0]"}
    damped = taut.linearise(loop_of(laws.PID(kp=0.0, kd=kd), arm))
    assert np.isinf(damped.frequency_response(0.0, output="q[0]", **push)[0])
    assert damped.frequency_response(0.0, output="v[0]", **push)[0] == pytest.approx(1.0 / kd, rel=1e-9)
    assert damped.sensitivity(0.0)[0, 0, 0] == pytest.approx(0.0, abs=1e-9)
    free = taut.linearise(loop_of(laws.PID(kp=0.0, kd=0.0), arm))
    for output in ("q[0]", "v[0]"):
        assert np.isinf(free.frequency_response(0.0, output=output, **push)[0])
    assert free.frequency_response(0.0, input="ref.q[0]", output="q[0]")[0] == 0.0
    ringing = taut.linearise(loop_of(laws.PID(kp=40.0, kd=0.0), arm))
    omega = np.array([0.0, 1.0, 1.001]) * ringing.modes[0].omega_n
    answers = ringing.frequency_response(omega, output="q[0]", **push)
    assert answers[0] == pytest.approx(1.0 / 40.0, rel=1e-9)
    assert np.isinf(answers[1])
    assert np.abs(answers[2]) == pytest.approx(1.0 / 40.0 / (1.001**2 - 1.0), rel=1e-2)


def test_a_pole_that_is_slow_is_none_at_rest() -> None:
    arm = weightless("one_joint")
    slow = taut.linearise(loop_of(laws.PID(kp=0.1, kd=40.0), arm))
    assert abs(slow.poles[0] - 1.0) < 1e-5
    still = slow.frequency_response(0.0, input="disturbance.torque[0]", output="q[0]")[0]
    assert still == pytest.approx(10.0, rel=1e-6)


def test_modes_state_their_joint_and_how_it_moves() -> None:
    arm = weightless("gantry3")
    lin = taut.linearise(loop_of(laws.PID(kp=[4e3, 2e3, 1e3], kd=[30.0, 20.0, 10.0]), arm))
    mass = np.diag(taut.snapshot(arm, arm.home).M)
    assert len(lin.modes) == 3
    for mode in lin.modes:
        j = int(next(iter(mode.participation))[-2])
        kp, kd = (4e3, 2e3, 1e3)[j], (30.0, 20.0, 10.0)[j]
        assert mode.omega_n == pytest.approx(np.sqrt(kp / mass[j]), rel=0.02)
        assert mode.zeta == pytest.approx(kd / (2.0 * np.sqrt(kp * mass[j])), abs=0.03)
        assert set(mode.participation) == {f"plant.q[{j}]", f"plant.v[{j}]"}
        assert sum(mode.participation.values()) == pytest.approx(1.0)


def test_a_motion_that_is_left_free_does_not_grow_and_one_that_is_pushed_on_does() -> None:
    arm = weightless("one_joint")
    damped = taut.linearise(loop_of(laws.PID(kp=0.0, kd=2.0), arm))
    assert damped.radius == pytest.approx(1.0)
    assert damped.stable
    assert not taut.linearise(loop_of(laws.PID(kp=0.0, kd=0.0), arm)).stable


def test_the_content_has_modes_and_margins_by_joint(rich_model: taut.LinearSystem) -> None:
    content = rich_model.content()
    tables = {table.title: table for table in content.tables}
    assert [row[0] for row in tables["margins"].rows][:7] == list(rich_model.point.joints)
    assert len(tables["modes"].rows) == len(rich_model.modes)
    assert content.summary
    assert not content.faults


# -------------------------------------------------------------------- bad input

planar = taut.load_arm("planar2")


def planar_loop(**gains: float) -> taut.Loop:
    return loop_of(laws.PID(**gains), planar)


def moving() -> taut.Loop:
    path = taut.trajectories.Quintic(q0=[0.0, 0.0], q1=[0.1, 0.1], duration=0.1)
    return loop_of(laws.PID(kp=100.0, kd=20.0), planar, ref=path)


MISUSE: dict[str, tuple[type[Exception], Callable[[], object]]] = {
    "far": (
        taut.errors.RangeError,
        lambda: taut.linearise(planar_loop(kp=5.0, kd=2.0), at=[0.3, 0.5]),
    ),
    "moving reference": (
        taut.errors.UsageError,
        lambda: taut.linearise(moving()),
    ),
    "not finite": (
        taut.errors.RangeError,
        lambda: taut.linearise(planar_loop(kp=100.0, kd=20.0), at=[0.0, float("nan")]),
    ),
    "joints": (
        taut.errors.ShapeError,
        lambda: taut.linearise(planar_loop(kp=100.0, kd=20.0), at=[0.0, 0.0, 0.0]),
    ),
    "degrees": (
        taut.errors.RangeError,
        lambda: taut.linearise(loop_of(laws.PID(kp=10.0, kd=2.0), taut.load_arm("panda")), at=np.full(7, 45.0)),
    ),
    "phases": (
        taut.errors.UsageError,
        lambda: taut.linearise(
            taut.Loop(
                taut.compile(
                    [taut.Phase(laws.PID(kp=100.0), taut.JointMotion(q=[0.1, 0.2]), until=lambda x: x.elapsed > 0.1)],
                    planar,
                ),
                Plant(planar, friction=None),
                duration=0.5,
            )
        ),
    ),
    "no loop": (
        taut.errors.UsageError,
        lambda: taut.linearise(planar),  # type: ignore[arg-type]
    ),
    "beyond half the rate": (
        taut.errors.RangeError,
        lambda: taut.linearise(planar_loop(kp=500.0, kd=20.0)).frequency_response(1e4, input="ref.q", output="q"),
    ),
    "input": (
        taut.errors.UnknownNameError,
        lambda: taut.linearise(planar_loop(kp=500.0, kd=20.0)).frequency_response(1.0, input="ref.p", output="q"),
    ),
}


@pytest.mark.parametrize("case", MISUSE)
def test_bad_input_is_refused(case: str) -> None:
    kind, call = MISUSE[case]
    with pytest.raises(kind):
        call()


def test_an_equilibrium_that_is_far_is_refused_with_the_joint_and_its_distance() -> None:
    with pytest.raises(taut.errors.RangeError) as caught:
        taut.linearise(planar_loop(kp=5.0, kd=2.0), at=[0.3, 0.5])
    assert caught.value.joint == "joint1"
    assert caught.value.value == pytest.approx(1.44, abs=0.01)


def slide(kp: float, kd: float, rate: float) -> taut.LinearSystem:
    """A slide without weight under a spring and a damper, and one beside it that only a damper holds."""
    arm = taut.load_arm("gantry3", gravity=(0.0, 0.0, 0.0)).subset(["x", "y"])
    ctrl = taut.compile(laws.GravityPID(kp=[kp, 0.0], kd=[kd, kd]), arm, rate=rate)
    return taut.linearise(taut.Loop(ctrl, Plant(arm, friction=None), duration=1.0))


def test_a_slow_pole_beside_one_that_stays_is_no_second_pole_at_one() -> None:
    """-kp / kd = -0.05 1/s: at 4 kHz 1.25e-5 from the pole at one of the slide that nothing draws back."""
    lin = slide(kp=20.0, kd=400.0, rate=4000.0)
    assert sorted(np.abs(lin.poles - 1.0))[:2] == pytest.approx([0.0, 0.05 / 4000.0], rel=1e-2, abs=1e-12)
    assert lin.stable


def test_a_motion_that_nothing_damps_is_not_stable_and_says_so() -> None:
    lin = slide(kp=20.0, kd=0.0, rate=1000.0)
    assert not lin.stable
    free = laws.GravityCompensation()
    arm = taut.load_arm("gantry3")
    lin = taut.linearise(taut.Loop(taut.compile(free, arm), Plant(arm, friction=None), duration=1.0))
    assert not lin.stable
    assert lin.unstable_because.startswith("marginally stable")
