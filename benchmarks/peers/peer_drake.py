"""Drake (`pip install drake`): a diagram of its own systems, all of them in C++."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.controllers import InverseDynamicsController
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Sine
from worker import Array, Case, Task, impedance, ticks, tool_ticks


def plant_of(task: Task, robot: str) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(task.urdf(robot))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("link0"))
    plant.mutable_gravity_field().set_gravity_vector(np.array(task.robots[robot]["gravity"]))
    for joint in task.robots[robot]["joints"]:
        plant.AddJointActuator(joint["name"], plant.GetJointByName(joint["name"]))
    plant.Finalize()
    return plant


def tick(task: Task, robot: str) -> Case:
    """Inverse dynamics of the plant, with gains in NumPy: less than half the time of InverseDynamicsController."""
    plant, kp, kd = plant_of(task, robot), task.kp, task.kd
    context, forces = plant.CreateDefaultContext(), MultibodyForces(plant)

    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        gravity = plant.CalcGravityGeneralizedForces(context)
        a = a_des + kp * (q_des - q) + kd * (v_des - v)
        return plant.CalcInverseDynamics(context, a, forces) - gravity

    return ticks(task, robot, law, "CalcInverseDynamics, CalcGravityGeneralizedForces")


def tool_tick(task: Task) -> Case:
    plant = plant_of(task, "panda")
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    tool = plant.GetFrameByName("tool")
    zero, kind = np.zeros(3), JacobianWrtVariable.kV
    order = [3, 4, 5, 0, 1, 2]  # its 6-vectors have the angular part first

    def law(q: Array, v: Array, *target: Array) -> Array:
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        M = plant.CalcMassMatrix(context)
        h = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        J = plant.CalcJacobianSpatialVelocity(context, kind, tool, zero, world, world)[order]
        bias = plant.CalcBiasSpatialAcceleration(context, kind, tool, zero, world, world)
        Jdot_v = np.concatenate([bias.translational(), bias.rotational()])
        X = tool.CalcPoseInWorld(context)
        return impedance(task, M, h, J, Jdot_v, X.translation(), X.rotation().matrix(), q, v, target)

    how = "CalcMassMatrix, CalcBiasTerm, CalcJacobianSpatialVelocity, CalcBiasSpatialAcceleration"
    return tool_ticks(task, law, how)


def closed_loop(task: Task, robot: str) -> Case:
    """The sine, the controller and the loaded arm as one diagram."""
    n, steps = len(task.robots[robot]["joints"]), 400
    center, amplitude, omega = task.sine(robot)
    builder, model, ones = DiagramBuilder(), plant_of(task, robot), np.ones(n)
    plant = builder.AddSystem(plant_of(task, robot + "_loaded"))
    control = builder.AddSystem(InverseDynamicsController(model, task.kp * ones, 0.0 * ones, task.kd * ones, True))
    # Sine gives a sin, its first and its second derivative; a state is positions, then velocities.
    phases = np.repeat([0.0, np.pi / 2], n)
    place = builder.AddSystem(Sine(np.hstack([amplitude, amplitude * omega]), np.hstack([omega, omega]), phases))
    fast = builder.AddSystem(Sine(amplitude, omega, np.zeros(n)))
    middle = builder.AddSystem(ConstantVectorSource(np.hstack([center, np.zeros(n)])))
    total = builder.AddSystem(Adder(2, 2 * n))
    for source, target in (
        (place.get_output_port(0), total.get_input_port(0)),
        (middle.get_output_port(), total.get_input_port(1)),
        (total.get_output_port(), control.get_input_port_desired_state()),
        (fast.get_output_port(2), control.get_input_port_desired_acceleration()),
        (plant.get_state_output_port(), control.get_input_port_estimated_state()),
        (control.get_output_port_control(), plant.get_actuation_input_port()),
    ):
        builder.Connect(source, target)
    simulator = Simulator(builder.Build())
    scheme = {"integration_scheme": "semi_explicit_euler", "max_step_size": task.dt, "use_error_control": False}
    ApplySimulatorConfig(SimulatorConfig(**scheme, accuracy=0.1), simulator)
    context = simulator.get_mutable_context()
    own = plant.GetMyMutableContextFromRoot(context)

    def call() -> Array:
        context.SetTime(0.0)
        plant.SetPositions(own, center)
        plant.SetVelocities(own, amplitude * omega)
        simulator.Initialize()
        simulator.AdvanceTo(steps * task.dt)
        return plant.GetPositions(own)

    return Case(call, steps, "a diagram of Sine, InverseDynamicsController, MultibodyPlant; semi_explicit_euler")


CASES = {"tick": tick, "impedance": tool_tick, "loop": closed_loop}
