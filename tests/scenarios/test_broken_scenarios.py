"""Every value that a scenario cannot have is refused in one line that names file, section and key; nothing is written."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from taut.cli.main import main

GOOD: dict[str, Any] = {
    "title": "t",
    "arm": {"model": "planar2"},
    "laws": {"PD": {"law": "PID", "kp": 10, "kd": [1, 1]}},
    "control": {"rate": 1000},
    "plant": {"kind": "rigid"},
    "reference": {"kind": "set-point", "q": [0.1, 0.2]},
    "run": {"duration": 0.05},
}
GONE = object()
CUBIC = {"kind": "cubic", "q0": "home", "q1": [0.1, 0.2], "duration": 1.0}
SPLINE = {"kind": "spline", "times": [0.0, 1.0], "points": [[0.0, 0.0], [0.1, 0.1]]}
JERK = {"kind": "jerk-limited", "q0": [0, 0], "q1": [1, 1], "velocity": 1, "acceleration": 1}
PASS = {"law": "PD", "metric": "rms_error", "max": 1}
VELOCITY = {"takes": "velocity", "actuation": {"bandwidth": 50.0}}
NAN, INF = float("nan"), float("inf")

# What is changed, by dotted path; the section that the message names, None where the words do; how it goes on.
CASES: dict[str, tuple[dict[str, Any], str | None, str]] = {
    # the file as a whole
    "a misspelt section": ({"control": GONE, "contrl": {}}, "", " has no key 'contrl'; did you mean 'control'?"),
    "a section that is no table": ({"control": 500}, "", " control must be a table: [control]; got 500"),
    "no plant": ({"plant": GONE}, "", " needs the section [plant]"),
    "no run": ({"run": GONE}, "", " needs the section [run]"),
    "a title that is a number": ({"title": 3}, "", " title must be a text in quotes; got 3"),
    "events that are a table": ({"event": {"t": 1}}, "", " event must be an array of tables: [[event]]; got {'t': 1}"),
    # [arm]
    "no model": ({"arm": {}}, "arm", "needs the key 'model'"),
    "an unknown arm": ({"arm.model": "planer2"}, "arm", "model: taut has no arm 'planer2'; did you mean 'planar2'"),
    "an arm that is a file elsewhere": ({"arm.model": "no/such.urdf"}, "arm", "model '{folder}/no/such.urdf' does not exist (paths begin at the scenario's own folder)"),
    "a model with a name of 5000 letters": ({"arm.model": "/" + "a" * 5000 + ".urdf"}, "arm", "model '/aaaa"),
    "a model without a name": ({"arm.model": ""}, "arm", "model must be a name or a path; got ''"),
    "an unknown tool": ({"arm.tool": "tol"}, "arm", "tool: model 'planar2' has no frame 'tol'; did you mean 'tool'?"),
    "a pose with two angles": ({"arm.T_WB": {"rpy": [1, 2]}}, "arm.T_WB", "rpy must have shape (3,) [rad]"),
    "a pose with two rotations": (
        {"arm.T_WB": {"rpy": [0, 0, 0], "xyzw": [0, 0, 0, 1]}},
        "arm.T_WB",
        "a pose takes one rotation; got xyzw and rpy; keep one",
    ),
    "a pose that is an array": ({"arm.T_WB": [1, 2, 3]}, "arm", "T_WB must be a table: [arm.T_WB]; got [1, 2, 3]"),
    "gravity in a plane": ({"arm.gravity": [0, 0]}, "arm", "gravity must have shape (3,) [m/s^2]; got shape (2,)"),
    "a home pose in words": ({"arm.home": "up"}, "arm", "home must be numbers; got 'up'"),
    "locked joints in words": ({"arm.locked": "joint1"}, "arm", "locked must be joint names with positions"),
    "an unknown joint to lock": ({"arm.locked": {"joint9": 0}}, "arm", "locked: model 'planar2' has no joint 'joint9'"),
    "an unknown joint to keep": ({"arm.joints": ["joint9"]}, "arm", "joints: model 'planar2' has no joint 'joint9'"),
    "joints that are a number": ({"arm.joints": 3}, "arm", "joints must name joints; got 3"),
    "an unknown body": (
        {"arm.bodies": {"joint9": {"mass": 1}}},
        "arm.bodies.joint9",
        "arm 'planar2' has no joint 'joint9'; did you mean 'joint2' or 'joint1'?",
    ),
    "a body without a mass": ({"arm.bodies": {"joint1": {"mass": "x"}}}, "arm.bodies.joint1", "mass must be a number"),
    "an unknown joint value": (
        {"arm.joint_values": {"viscus": [1, 2]}},
        "arm.joint_values",
        "a joint has no field 'viscus'; did you mean 'viscous'?",
    ),
    "a joint value called self": ({"arm.joint_values": {"self": 1}}, "arm.joint_values", "a joint has no field 'self'"),
    "a payload without a mass": ({"arm.payload": {"com": [0, 0, 0]}}, "arm.payload", "needs the key 'mass'"),
    "a misspelt mass": ({"arm.payload": {"mas": 1}}, "arm.payload", "has no key 'mas'; did you mean 'mass'?"),
    "a payload of negative mass": ({"arm.payload": {"mass": -1}}, "arm.payload", "mass must be >= 0 [kg]; got -1.0"),
    "a link for another arm": ({"arm.link": {"r": 0.1}}, "arm", "link is for the model 'one_joint'; got model 'planar2'"),
    "a misspelt number of the link": (
        {"arm": {"model": "one_joint", "link": {"R": 0.1}}},
        "arm.link",
        "has no key 'R'; it takes 'M', 'b', 'm', 'r'",
    ),
    # [laws]
    "no laws": ({"laws": {}}, "laws", "needs one law at least"),
    "a law that is a number": ({"laws.PD": 3}, "laws", "PD must be a table: [laws.PD]; got 3"),
    "an unknown law": (
        {"laws.PD.law": "PDI"},
        "laws.PD",
        "law: taut.laws has no law 'PDI'; did you mean 'PID'",
    ),
    "a law's name that is a number": ({"laws.PD.law": 3}, "laws.PD", "law must be a text in quotes; got 3"),
    "a sum with a number": ({"laws.PD.law": [3]}, "laws.PD", 'law must be an array of texts such as ["FeedForward", "PID"]'),
    "a sum of nothing": ({"laws.PD.law": []}, "laws.PD", "law must be the name of a law, or an array of one at least; got []"),
    "a sum with a law twice": (
        {"laws.PD": {"law": ["PID", "PID"], "PID": {"kp": 1}}},
        "laws.PD",
        "law must name each law once; got 'PID' 2 times",
    ),
    "a sum that adds gravity twice": (
        {"laws.PD": {"law": ["GravityPID", "GravityCompensation"], "GravityPID": {"kp": 1, "kd": 1}}},
        "laws.PD",
        "GravityPID + GravityCompensation: both compensate gravity",
    ),
    "a sum without gains": ({"laws.PD": {"law": ["FeedForward", "PID"]}}, "laws.PD.PID", "PID needs kp"),
    "a misspelt gain that must be there": (
        {"laws.PD": {"law": "PID", "kpp": 1}},
        "laws.PD",
        "has no key 'kpp'; did you mean 'kp'?",
    ),
    "a misspelt gain": ({"laws.PD.kdd": 1}, "laws.PD", "has no key 'kdd'; did you mean 'kd'?"),
    "a negative gain": ({"laws.PD.kp": -1}, "laws.PD", "kp must be >= 0"),
    "a gain that is NaN": ({"laws.PD.kp": NAN}, "laws.PD", "kp must be finite"),
    "a gain that is true": ({"laws.PD.kp": True}, "laws.PD", "kp must be real numbers"),
    "a gain of another size": ({"laws.PD.kp": [1, 2, 3]}, "laws.PD", "kp must be a scalar, (2,) or (2, 2) for 2 joints"),
    "a law that holds none": ({"laws.PD": {"law": "RaisedGains", "factor": 2}}, "laws.PD", "needs the section [laws.PD.inner]"),
    "a law that holds an unknown one": (
        {"laws.PD": {"law": "RaisedGains", "factor": 2, "inner": {"law": "PDI"}}},
        "laws.PD.inner",
        "law: taut.laws has no law 'PDI'; did you mean 'PID'",
    ),
    "a misspelt gain of a law that is held": (
        {"laws.PD": {"law": "RaisedGains", "factor": 2, "inner": {"law": "PID", "kp": 1, "kdd": 1}}},
        "laws.PD.inner",
        "has no key 'kdd'; did you mean 'kd'?",
    ),
    "a dither that is too fast": (
        {"laws.PD": {"law": "Dither", "amplitude": 1, "frequency": 900}},
        "laws.PD",
        "frequency of a Dither must be below",
    ),
    # [control]
    "a rate of zero": ({"control.rate": 0}, "control", "rate must be > 0 [Hz]; got 0.0"),
    "an endless rate": ({"control.rate": INF}, "control", "rate must be finite; got inf"),
    "a rate that is text": ({"control.rate": "fast"}, "control", "rate must be a number; got 'fast'"),
    "a rate that no controller has": ({"control.rate": 1e9}, "control", "rate must be <= 1e+06 [Hz]; got 1e+09"),
    "a rate in seconds": ({"control.rate": 0.001}, "control", "rate must be in ticks per second, >= 1 [Hz]"),
    "a run of no period": ({"run.duration": 1e-4}, "run", "duration must be >= 0.001 [s], one control period"),
    "another velocity": ({"control.velocity": "diff"}, "control", "velocity must be one of 'measured', 'difference'"),
    "the kinds of velocity": (
        {"control.velocity": 80},
        "control",
        "velocity must be one of 'measured', 'difference', or a table with kind = one of 'low-pass', 'difference', 'kalman'; got 80\n",
    ),
    "sensing in its own table": (
        {"control.sensing": {"velocity": "difference"}},
        "control",
        "has no key 'sensing'; it takes 'F_ext', 'limits', 'notch', 'rate', 'tau_meas', 'velocity', 'wrist'\n",
    ),
    "limits of an arm that states none": ({"control.limits": "arm"}, "control", "limits: planar2: arm 'planar2' states no"),
    "the way out of it": (
        {"control.limits": "arm"},
        "control",
        "limits: planar2: arm 'planar2' states no effort limits; write limits = { tau = [...] }\n",
    ),
    "misspelt limits": ({"control.limits": {"taus": 1}}, "control.limits", "has no key 'taus'; did you mean 'tau'?"),
    "limits of nothing": (
        {"control.limits": {}},
        "control.limits",
        "needs one of tau, tau_dot, v and blend at least; for no limits write limits = \"none\"\n",
    ),
    "a blend of no time": ({"control.limits": {"blend": 0}}, "control.limits", "blend must be > 0 [s]; got 0.0"),
    "limits of another arm": ({"control.limits": {"of": "robot"}}, "control.limits", "of must be one of 'arm', 'arm with rate', 'arm with speed'"),
    "a gain without a speed limit": ({"control.limits": {"tau": 1, "v_gain": 5}}, "control.limits", "v_gain belongs to a speed limit; give v too"),
    "a speed limit faster than the rate": (
        {"control.limits": {"v": 1, "v_gain": 5000}, "control.rate": 100},
        "control.limits",
        "v_gain must be at most the rate, 100 [1/s]",
    ),
    "limits of another size": ({"control.limits": {"tau": [1, 2, 3]}}, "control.limits", "tau must have shape (2,)"),
    "negative limits": ({"control.limits": {"tau": -1}}, "control.limits", "tau must be > 0"),
    "a velocity without its numbers": (
        {"control.velocity": "kalman"},
        "control",
        'velocity = "kalman" needs its numbers: { kind = "kalman", acceleration_noise = ..., position_noise = ... }\n',
    ),
    "another kind of velocity": ({"control.velocity": {"kind": "median"}}, "control.velocity", "kind must be one of 'low-pass', 'difference', 'kalman'; got 'median'"),
    "a velocity of no kind": ({"control.velocity": {"cutoff": 30}}, "control.velocity", "needs the key 'kind'"),
    "a low-pass without a cut-off": ({"control.velocity": {"kind": "low-pass"}}, "control.velocity", "needs the key 'cutoff'"),
    "a key of another velocity": ({"control.velocity": {"kind": "kalman", "cutoff": 3}}, "control.velocity", "has no key 'cutoff'"),
    "a cut-off of zero": (
        {"control.velocity": {"kind": "difference", "cutoff": 0}},
        "control.velocity",
        "cutoff must be > 0 [Hz]; got 0.0; leave it out for no low-pass\n",
    ),
    "a cut-off above half the rate": (
        {"control.velocity": {"kind": "low-pass", "cutoff": [30, 600]}},
        "control.velocity",
        "cutoff[1] (joint 'joint2') must be < 500 [Hz], half the controller's rate of 1000 Hz; got 600.0; make it lower, or the "
        "rate higher\n",
    ),
    "an order that there is not": ({"control.velocity": {"kind": "low-pass", "cutoff": 3, "order": 3}}, "control.velocity", "order must be one of 1, 2; got 3"),
    "a notch without a width": ({"control.notch": {"frequency": 18}}, "control.notch", "needs the key 'width'"),
    "a notch in words": ({"control.notch": "18 Hz"}, "control", "notch must be a table: [control.notch]; got '18 Hz'"),
    "a filter of what no law uses": (
        {"control.F_ext": {"cutoff": 30}},
        "control",
        "sensing filters F_ext, which PID does not use; leave F_ext= out of the sensing\n",
    ),
    "a wrist that no law reads": (
        {"control.wrist": {"mass": 0.7}},
        "control",
        "sensing corrects F_ext, which PID does not use; leave wrist= out of the sensing\n",
    ),
    "a misspelt mass of a tool": ({"control.wrist": {"mas": 0.7}}, "control.wrist", "has no key 'mas'; did you mean 'mass'?"),
    "a centre without a mass": ({"control.wrist": {"com": [0, 0, 0.1]}}, "control.wrist", "wrist.com is that of the tool, whose mass is missing; give mass too\n"),
    "one number for force and moment": ({"control.wrist": {"bias": 1}}, "control.wrist", "bias must be (force, moment) or six numbers [N, N m]; got shape ()"),
    "a tool of negative mass": (
        {"plant.sensors": {"wrench": {"tool": {"mass": -1}}}},
        "plant.sensors.wrench.tool",
        "mass must be >= 0 [kg]; got -1.0\n",
    ),
    "a tool in words": ({"plant.sensors": {"wrench": {"tool": "gripper"}}}, "plant.sensors.wrench", "tool must be a table: [plant.sensors.wrench.tool]; got 'gripper'"),
    "a wrist sensor on another link": (
        {"plant.sensors": {"wrench": {"tool": {"mass": 1}, "frame": "link1"}}},
        "plant",
        "sensors.wrench.frame must move with the tool 'tool'; got 'link1', which has a joint between it and the tool; name a frame of the "
        "last body\n",
    ),
    "limits of a velocity": (
        {"control.limits": {"tau": 1}, "laws.PD": {"law": "VelocityPI", "kp": 1}, "plant": VELOCITY},
        "control",
        "limits.tau is for torques, and VelocityPI gives a velocity; leave it out, or write limits = { v = [...] }",
    ),
    # [plant]
    "another kind of plant": ({"plant.kind": "soft"}, "plant", "kind must be one of 'rigid', 'mujoco'; got 'soft'"),
    "a plant with other joints": (
        {"plant.model": "planar3"},
        "plant",
        "model must have as many joints as that of [arm], the 2 of 'planar2'; got the 3 of 'planar3'",
    ),
    "an unknown plant": ({"plant.model": "planar33"}, "plant", "model: taut has no arm 'planar33'"),
    "adds that is a number": ({"plant.adds": 3}, "plant", 'adds must be an array of texts such as ["gravity"]; got 3'),
    "adds that is a text": ({"plant.adds": "gravity"}, "plant", "adds must be an array of texts such as [\"gravity\"]; got 'gravity'"),
    "adds with a number": ({"plant.adds": [1]}, "plant", 'adds must be an array of texts such as ["gravity"]; got [1]'),
    "an unknown thing to add": ({"plant.adds": ["weight"]}, "plant", "adds: what a plant adds has no component 'weight'"),
    "an unknown integrator": ({"plant.integrator": "euler"}, "plant", "integrator must be one of"),
    "no substeps": ({"plant.substeps": 0}, "plant", "substeps must be between 1 and 1000; got 0"),
    "half a substep": ({"plant.substeps": 0.5}, "plant", "substeps must be a whole number; got 0.5"),
    "another command": ({"plant.takes": "power"}, "plant", "takes must be one of"),
    "a command that the law does not give": ({"plant": VELOCITY}, "plant", "takes: PID gives a torque and plant"),
    "drives of MuJoCo without a bandwidth": ({"plant": {"kind": "mujoco", "takes": "velocity"}}, "plant", "a plant that takes velocity needs the bandwidth of its drives: actuation = { bandwidth = 50.0 } [rad/s]\n"),
    "drives of MuJoCo that are too fast": (
        {"plant": {"kind": "mujoco", "takes": "velocity", "actuation": {"bandwidth": 200.0}}},
        "plant",
        "actuation: the inner loop of a drive of 200 rad/s is 10 times as fast, too fast for steps of 0.001 s (joint 'joint1'); give the plant "
        "timestep = 0.0005, or slower drives",
    ),
    "drives without a bandwidth": ({"plant.takes": "velocity"}, "plant", "a plant that takes velocity needs the bandwidth of its drives: actuation = { bandwidth = 50.0 } [rad/s]\n"),
    "a delay between ticks": (
        {"plant.actuation": {"delay": 0.0015}},
        "plant",
        "actuation.delay must be a whole number of control periods of 0.001 s",
    ),
    "a delay that no number holds": ({"plant.actuation": {"delay": 1e306}}, "plant", "actuation.delay is too large"),
    "a misspelt delay": ({"plant.actuation": {"dely": 1}}, "plant.actuation", "has no key 'dely'; did you mean 'delay'?"),
    "noise for other joints": ({"plant.sensors": {"position": {"noise": [1, 2, 3]}}}, "plant", "sensors.position.noise must have shape (2,)"),
    "noise in words": ({"plant.sensors": {"position": {"noise": "a"}}}, "plant.sensors.position", "noise must be numbers [rad | m]; got 'a'"),
    "noise of no sensor": (
        {"plant.sensors": {"noise": 1e-3}},
        "plant.sensors",
        "has no key 'noise', which a sensor has, as in [plant.sensors.position]; it takes 'motor', 'motor_velocity', 'position', "
        "'tip', 'torque', 'velocity', 'wrench'\n",
    ),
    "no position sensor": ({"plant.sensors": {"position": "none"}}, "plant.sensors", "position must be a table: [plant.sensors.position]; got 'none'"),
    "a resolution of zero": (
        {"plant.sensors": {"position": {"resolution": 0}}},
        "plant.sensors.position",
        "resolution must be > 0 [rad | m]; got 0.0; leave it out where there are no steps\n",
    ),
    "an encoder on another side": ({"plant.sensors": {"position": {"side": "both"}}}, "plant.sensors.position", "side must be one of 'link', 'motor'; got 'both'"),
    "a second encoder at the link": ({"plant.sensors": {"motor": {"side": "link"}}}, "plant.sensors", "sensors.motor is at the motor; got side='link'"),
    "a wrench sensor where nothing touches": (
        {"plant.sensors": {"wrench": {"range": [100, 10]}}},
        "plant",
        "sensors.wrench is for a plant that something touches, or whose tool it weighs; write [plant.environment] too, give it a "
        "tool, or leave it out\n",
    ),
    "no tachometer": (
        {"plant.sensors": {"velocity": "none"}},
        "plant",
        "kind: PID needs v, which plant 'RigidPlant(planar2)' does not measure; it measures tau_meas; velocity = \"difference\" in [control] "
        "needs positions only\n",
    ),
    "a perturbed arm without a seed": ({"plant.perturbed": {"mass": 0.1}}, "plant.perturbed", "needs the key 'seed'"),
    "a perturbed arm with a negative seed": ({"plant.perturbed": {"seed": -1}}, "plant.perturbed", "seed must be"),
    "a key of MuJoCo": (
        {"plant.timestep": 0.001},
        "plant",
        "has no key 'timestep', which is for kind = \"mujoco\"; it takes 'actuation', 'adds', 'bodies', 'energy', 'environment', 'friction', 'gears', "
        "'integrator', 'joint_values', 'kind', 'model', 'payload', 'perturbed', 'rotor_inertia', 'sensors', 'substeps', 'sweeps', "
        "'takes'\n",
    ),
    "a key of a rigid plant": (
        {"plant": {"kind": "mujoco", "substeps": 2}},
        "plant",
        "has no key 'substeps', which is for kind = \"rigid\"; it takes 'actuation', 'adds', 'bodies', 'environment', 'friction', ",
    ),
    # joints: friction, gears, drives
    "an unknown number of friction": ({"plant.friction": {"coulom": 1}}, "plant.friction", "has no key 'coulom'; did you mean 'coulomb'?"),
    "another friction": (
        {"plant.friction": "some"},
        "plant",
        "friction must be \"arm\", \"none\" or a table of its numbers, [plant.friction]; got 'some'\n",
    ),
    "friction that is a number": ({"plant.friction": 3}, "plant", 'friction must be "arm", "none" or a table of its numbers'),
    "the arm's friction in another word": (
        {"arm.friction": "arm"},
        "arm",
        "friction must be \"none\" or a table of its numbers, [arm.friction]; got 'arm'\n",
    ),
    "negative friction": ({"arm.friction": {"coulomb": [1, -1]}}, "arm.friction", "coulomb[1] must be >= 0 [N m | N]; got -1.0\n"),
    "friction for other joints": ({"plant.friction": {"viscous": [1, 2, 3]}}, "plant.friction", "viscous must have shape (2,) (2 joints); got shape (3,)"),
    "friction of an unknown joint": ({"plant.friction": {"coulomb": {"joint3": 1}}}, "plant.friction", "coulomb: arm 'planar2' has no joint 'joint3'"),
    "friction of a joint in words": ({"plant.friction": {"coulomb": {"joint1": "a"}}}, "plant.friction.coulomb", "joint1 must be a number; got 'a'"),
    "less friction at rest than in motion": (
        {"plant.friction": {"coulomb": 1, "static": {"joint2": 0.5}}},
        "plant.friction",
        "friction.static[1] must be >= friction.coulomb: friction at rest is no less than in motion; got 0.5 < 1 [N m | N]\n",
    ),
    "gears without a ratio": ({"plant.gears": {"motor_inertia": 1e-4}}, "plant.gears", "needs the key 'ratio'"),
    "gears without a rotor": ({"plant.gears": {"ratio": 100}}, "plant.gears", "needs the key 'motor_inertia'"),
    "gears that are a number": ({"plant.gears": 100}, "plant", "gears must be a table: [plant.gears]; got 100"),
    "a negative ratio": ({"plant.gears": {"ratio": -1, "motor_inertia": 1e-4}}, "plant.gears", "ratio[0] (joint 'joint1') must be > 0; got -1.0"),
    "gears of two joints": (
        {"arm.gears": {"ratio": {"joint1": 10}, "motor_inertia": {"joint2": 1e-4}}},
        "arm.gears",
        "ratio and motor_inertia by joint name must name the same joints; only one of them names 'joint1', 'joint2'\n",
    ),
    "gears of an unknown joint": ({"plant.gears": {"ratio": {"joint9": 10}, "motor_inertia": 1e-4}}, "plant.gears", "arm 'planar2' has no joint 'joint9'"),
    "a rotor that is given twice": (
        {"plant.gears": {"ratio": 1, "motor_inertia": 1e-4}, "plant.rotor_inertia": 1},
        "plant.gears",
        "motor_inertia and rotor_inertia of [plant] say the same; keep one\n",
    ),
    "gears with a loss": (
        {"plant.gears": {"ratio": 1, "motor_inertia": 1e-4, "efficiency": 1}},
        "plant.gears",
        "has no key 'efficiency'; it takes 'motor_inertia', 'ratio'\n",
    ),
    "a negative rotor": ({"plant.rotor_inertia": -1}, "plant", "rotor_inertia[0] (joint 'joint1') must be >= 0; got -1.0"),
    "rotors for other joints": ({"plant.rotor_inertia": [1, 2, 3]}, "plant", "rotor_inertia must be one number or 2, one per joint; got shape (3,)"),
    "a rotor of an unknown joint": ({"plant.rotor_inertia": {"j": 1}}, "plant", "rotor_inertia: arm 'planar2' has no joint 'j'"),
    "misspelt gears": ({"plant.geers": 1}, "plant", "has no key 'geers'; did you mean 'gears'?"),
    "a motor of two kinds": (
        {"plant.actuation": {"motor": {"peak": 1, "resistance": 1}}},
        "plant.actuation.motor",
        "has 'peak' of a speed-torque curve and 'resistance' of an electric motor; keep one kind\n",
    ),
    "a motor without limits": (
        {"plant.actuation": {"motor": {}}},
        "plant.actuation.motor",
        "needs peak, or stall and no_load, or all three; without limits leave it out\n",
    ),
    "a spring too stiff for MuJoCo's steps": (
        {
            "plant.kind": "mujoco",
            "plant.gears": {"ratio": 100, "motor_inertia": 1e-6},
            "plant.actuation": {"transmission": {"stiffness": 5e4}},
        },
        "plant",
        "timestep: the transmission of joint 'joint2' swings at 2.35e+03 rad/s, too fast for steps of 0.001 s; give the plant timestep = 0.000333333333,",
    ),
    "half a curve": ({"plant.actuation": {"motor": {"stall": 1}}}, "plant.actuation.motor", "needs both stall [N m] and no_load [rad/s], or neither\n"),
    "an electric motor without a constant": ({"plant.actuation": {"motor": {"resistance": 1}}}, "plant.actuation.motor", "needs the key 'torque_constant'"),
    "a misspelt resistance": ({"plant.actuation": {"motor": {"resistence": 1}}}, "plant.actuation.motor", "has no key 'resistence'; did you mean 'resistance'?"),
    "a negative peak": ({"plant.actuation": {"motor": {"peak": [1, -1]}}}, "plant.actuation.motor", "peak[1] must be > 0 [N m]; got -1.0"),
    "a peak for other joints": ({"plant.actuation": {"motor": {"peak": [1, 1, 1]}}}, "plant", "actuation.motor.peak must have shape (2,)"),
    "a motor in words": ({"plant.actuation": {"motor": "dc"}}, "plant.actuation", "motor must be a table: [plant.actuation.motor]; got 'dc'"),
    "half a ripple": ({"plant.actuation": {"ripple": {"amplitude": 0.1}}}, "plant.actuation.ripple", "needs the key 'periods'"),
    "gears that give back more": (
        {"plant.actuation": {"transmission": {"efficiency": 1.5}}},
        "plant.actuation.transmission",
        "actuation.transmission.efficiency must be above 0 and at most 1",
    ),
    "play without teeth": (
        {"plant.actuation": {"transmission": {"backlash": 0.01}}},
        "plant.actuation.transmission",
        "actuation.transmission.backlash needs a stiffness, that of the teeth or of the elastic part: stiffness = 1e4 [N m/rad]\n",
    ),
    "elasticity without a rotor": (
        {"plant.actuation": {"transmission": {"stiffness": 1e3}}},
        "plant",
        "joint 'joint1' has an elastic transmission or backlash, so its motor moves by itself and needs a rotor: give it gears or "
        "rotor_inertia\n",
    ),
    "a spring that is too fast": (
        {"plant": {"rotor_inertia": 1.0, "actuation": {"transmission": {"stiffness": 1e9}}}},
        "plant",
        "the transmission of joint 'joint2' swings at ",
    ),
    "a torque loop without gains": ({"plant.actuation": {"torque_loop": {}}}, "plant.actuation.torque_loop", "needs kp or ki above zero; without a loop leave it out\n"),
    "no sweeps": ({"plant.sweeps": 0}, "plant", "sweeps must be between 1 and 1000; got 0"),
    "an account of energy that is a number": ({"plant.energy": 1}, "plant", "energy must be true or false; got 1"),
    "drives of MuJoCo with a delay between ticks": (
        {"plant": {"kind": "mujoco", "actuation": {"delay": 0.0015}}},
        "plant",
        "actuation.delay must be a whole number of control periods of 0.001 s",
    ),
    # [plant.environment]
    "an environment that is a word": ({"plant.environment": "wall"}, "plant", "environment must be a table: [plant.environment]; got 'wall'"),
    "an environment without a kind": (
        {"plant.environment": {"stiffness": 3}},
        "plant.environment",
        "needs kind, one of 'spring', 'damper', 'wall', 'handle', 'hand', 'push', or a table for each of several: [plant.environment.wall]\n",
    ),
    "an empty environment": ({"plant.environment": {}}, "plant.environment", "needs kind, one of 'spring', "),
    "an unknown environment": ({"plant.environment": {"kind": "wal"}}, "plant.environment", "kind must be one of 'spring', 'damper', 'wall', 'handle', 'hand', 'push'; got 'wal'"),
    "one of several without a kind": ({"plant.environment": {"a": {"peak": [1, 0, 0]}}}, "plant.environment.a", "needs the key 'kind'"),
    "one of several with a name that is none": ({"plant.environment": {"my push": {"kind": "push"}}}, "plant.environment", "must name its tables by letters, digits and underscores; got 'my push'"),
    "a misspelt stiffness": ({"plant.environment": {"kind": "spring", "stifness": 1}}, "plant.environment", "has no key 'stifness'; did you mean 'stiffness'?"),
    "a spring without a stiffness": ({"plant.environment": {"kind": "spring"}}, "plant.environment", "needs the key 'stiffness'"),
    "a spring at a place with two rotations": (
        {"plant.environment": {"kind": "spring", "stiffness": 1, "at": {"rpy": [0, 0, 0], "xyzw": [0, 0, 0, 1]}}},
        "plant.environment.at",
        "a pose takes one rotation; got xyzw and rpy; keep one",
    ),
    "a negative damping": ({"plant.environment": {"kind": "damper", "damping": -1}}, "plant.environment", "damping must be >= 0 [N s/m]; got -1.0"),
    "a wall that is too stiff": (
        {"plant.environment": {"kind": "wall", "point": [0, 0, -1], "normal": [0, 0, 1], "stiffness": 1e8}},
        "plant",
        "environment: what touches the tool swings at ",
    ),
    "a wall that is too stiff in MuJoCo": (
        {"plant": {"kind": "mujoco", "environment": {"kind": "wall", "point": [0, 0, -1], "normal": [0, 0, 1], "stiffness": 1e8}}},
        "plant",
        "environment: what touches the tool swings at ",
    ),
    "a hand that wants a word": ({"plant.environment": {"kind": "hand", "mass": 1, "damping": 1, "stiffness": 1, "motion": "wave"}}, "plant.environment", "motion must be a table: [plant.environment.motion]; got 'wave'"),
    "a hand with an unknown motion": (
        {"plant.environment": {"kind": "hand", "mass": 1, "damping": 1, "stiffness": 1, "motion": {"kind": "sine"}}},
        "plant.environment.motion",
        "kind must be one of 'oscillation', 'noise'; got 'sine'",
    ),
    "a push in a plane": ({"plant.environment": {"kind": "push", "peak": [1, 2]}}, "plant.environment", "push.peak must be a force (3,) [N] or a wrench (6,), force first"),
    # [cases]
    "cases that are a number": ({"cases": 3}, "", " cases must be a table: [cases]; got 3"),
    "no cases": ({"cases": {}}, "cases", 'needs one case at least: [cases."G = 100".plant.gears] with the keys that it replaces\n'),
    "a case that is a number": ({"cases": {"a": 3}}, "cases", "a must be a table: [cases.a]; got 3"),
    "a case without a name": ({"cases": {"": {}}}, "cases", "has a case without a name\n"),
    "a misspelt section of a case": ({"cases": {"a": {"pland": {}}}}, "cases.a", "has no key 'pland'; did you mean 'plant'?"),
    "a case with a title": (
        {"cases": {"a": {"title": "x"}}},
        "cases.a",
        "has no key 'title', which all cases share; it takes 'arm', 'control', 'event', 'laws', 'phases', 'plant', 'reference', 'run'\n",
    ),
    "a case with a law of its own": (
        {"cases": {"a": {"laws": {"PID": {"kp": 1}}}}},
        "cases.a",
        "changes the law 'PID', which [laws] does not have: every law runs in every case\n",
    ),
    "a wrong value in the second case": ({"cases": {"a": {}, "b": {"plant": {"substeps": 0}}}}, None, ": case 'b': [plant] substeps must be between 1 and 1000; got 0\n"),
    "a case in which a law does not fit": (
        {"cases": {"a": {"laws": {"PD": {"kp": [1, 2, 3]}}}}},
        None,
        ": case 'a': [laws.PD] kp must be a scalar, (2,) or (2, 2) for 2 joints",
    ),
    "a case with another arm": ({"cases": {"a": {"arm": {"model": "planar3"}}}}, None, ": case 'a': [reference] q must have one entry for each of the 3 joints"),
    "a case that puts a number for a table": ({"cases": {"a": {"plant": 3}}}, None, ": case 'a' plant must be a table: [plant]; got 3"),
    "a pass figure of an unknown case": ({"cases": {"a": {}}, "pass": [{**PASS, "case": "b"}]}, "pass 1", "case must be one of 'a'; got 'b'"),
    "a pass figure of a case where there are none": ({"pass": [{**PASS, "case": "b"}]}, "pass 1", "case is for a scenario with cases, [cases.'b']; leave it out"),
    "an unknown case to show": ({"cases": {"a": {}}, "outputs": {"shown_case": "b"}}, "outputs", "shown_case must be one of 'a'; got 'b'"),
    "a plot of nine cases": (
        {"cases": {f"case {i}": {} for i in range(9)}, "outputs": {"plot": "x.png"}},
        "outputs",
        "plot draws at most 8 laws, counted in each case; got 9; leave it out, or some of the laws\n",
    ),
    "an unknown metric to show": ({"outputs": {"columns": ["rms"]}}, "outputs", "columns: a run has no metric 'rms'; it has"),
    "no metric to show": ({"outputs": {"columns": []}}, "outputs", "columns must name one metric at least, each once; got []"),
    "a metric to show twice": ({"outputs": {"columns": ["effort", "effort"]}}, "outputs", "columns must name one metric at least, each once"),
    "metrics in one text": ({"outputs": {"columns": "effort"}}, "outputs", 'columns must be an array of texts such as ["rms_error", "stuck_time"]; got'),
    "an unknown joint to show": ({"outputs": {"joint": "joint3"}}, "outputs", "joint: arm 'planar2' has no joint 'joint3'; did you mean 'joint2'"),
    "a smooth integrator with dry friction": (
        {"plant": {"integrator": "rk4", "joint_values": {"coulomb": [1, 1]}}},
        "plant",
        "integrator: rk4 needs smooth forces, and arm 'planar2' has dry friction; use semi-implicit-euler, or friction = \"none\"\n",
    ),
    "a plant that is a file elsewhere": (
        {"plant.model": "no.urdf"},
        "plant",
        "model '{folder}/no.urdf' does not exist (paths begin at the scenario's own folder)",
    ),
    "a scene that is not there": (
        {"plant": {"kind": "mujoco", "scene": "no.xml"}},
        "plant",
        "scene '{folder}/no.xml' does not exist (paths begin at the scenario's own folder)",
    ),
    "a scene that is not there, with its whole path": (
        {"plant": {"kind": "mujoco", "scene": "/no/such.xml"}},
        "plant",
        "scene '/no/such.xml' does not exist\n",
    ),
    "a time step that does not fit": (
        {"plant": {"kind": "mujoco", "timestep": 0.0007}},
        "plant",
        "plant 'MujocoPlant(planar2)': the control period must be a whole number of time steps",
    ),
    "a time step of zero": ({"plant": {"kind": "mujoco", "timestep": 0.0}}, "plant", "timestep must be > 0 [s]"),
    "a time step for years": (
        {"plant": {"kind": "mujoco", "timestep": 1e-9}},
        "plant",
        "timestep must be >= 1e-06 [s], 1000 of which make a control period; got 1e-09",
    ),
    # [reference]
    "another kind of reference": ({"reference.kind": "spiral"}, "reference", "kind must be one of 'hold', 'set-point'"),
    "a reference without a kind": ({"reference": {"q": [0, 0]}}, "reference", "needs the key 'kind'"),
    "a reference for other joints": ({"reference.q": [0.1]}, "reference", "q must have one entry for each of the 2 joints; got 1"),
    "the same from home": (
        {"reference": {"kind": "set-point", "q": [0.1], "relative_to_home": True}},
        "reference",
        "q must have one entry for each of the 2 joints; got 1",
    ),
    "a reference that is a number": ({"reference.q": 0.1}, "reference", "q must be a vector (n,); got shape ()"),
    "the same number from home": (
        {"reference": {"kind": "set-point", "q": 0.1, "relative_to_home": True}},
        "reference",
        "q must be a vector (n,); got shape ()",
    ),
    "a reference in words": ({"reference.q": "hom"}, "reference", "q must be numbers, one per joint, or \"home\"; got 'hom'"),
    "words from home": (
        {"reference": {"kind": "set-point", "q": "a", "relative_to_home": True}},
        "reference",
        "q must be numbers, one per joint, or \"home\"; got 'a'",
    ),
    "a ragged reference from home": (
        {"reference": {"kind": "set-point", "q": [[1], [2, 3]], "relative_to_home": True}},
        "reference",
        "q must be numbers [rad | m] in a rectangular array",
    ),
    "a reference with NaN": ({"reference.q": [0.2, NAN]}, "reference", "q[1] must be finite [rad | m]; got nan"),
    "a hold from home": ({"reference": {"kind": "hold", "relative_to_home": True}}, "reference", "has no key 'relative_to_home'"),
    "a start for other joints": ({"reference": {**CUBIC, "q0": [1, 2, 3]}}, "reference", "q0 must have one entry for each of the 2"),
    "scalars for all joints": ({"reference": {**CUBIC, "q0": 0, "q1": 1}}, "reference", "q0 must have one entry for each of the 2"),
    "a motion that takes no time": ({"reference": {**CUBIC, "duration": 0}}, "reference", "duration must be > 0 [s]; got 0.0"),
    "a motion that is faster than numbers": ({"reference": {**CUBIC, "duration": 1e-300}}, "reference", "duration must be long enough"),
    "a missing limit": ({"reference": JERK}, "reference", "needs the key 'jerk'"),
    "a misspelt limit": (
        {"reference": {**JERK, "jrk": 1}},
        "reference",
        "has no key 'jrk'; did you mean 'jerk'?",
    ),
    "a key of another trajectory": ({"reference": {**CUBIC, "velocity": 1}}, "reference", "has no key 'velocity'"),
    "times that go back": ({"reference": {**SPLINE, "times": [1.0, 0.0]}}, "reference", "times must increase"),
    "points for other joints": (
        {"reference": {**SPLINE, "points": [[0.0], [1.0]]}},
        "reference",
        "points must have one entry for each of the 2 joints; got 1",
    ),
    "samples that are not there": ({"reference": {"kind": "samples", "file": "no.csv"}}, "reference", "file: CSV file '{folder}/no.csv' does not exist (paths begin at the scenario's own folder)"),
    # [run]
    "a missing duration": ({"run": {}}, "run", "needs the key 'duration'"),
    "a misspelt duration": ({"run": {"duraton": 1}}, "run", "needs the key 'duration'; is 'duraton' meant for it?"),
    "a negative duration": ({"run.duration": -1}, "run", "duration must be > 0 [s]; got -1.0"),
    "a duration of zero": ({"run.duration": 0}, "run", "duration must be > 0 [s]; got 0.0"),
    "a duration of ages": (
        {"run.duration": 1e12},
        "run",
        "duration must be <= 10000 [s] at 1000 Hz, as a run keeps every tick; got 1e+12",
    ),
    "an endless duration": ({"run.duration": INF}, "run", "duration must be finite; got inf"),
    "a duration in words": ({"run.duration": "x"}, "run", "duration must be a number; got 'x'"),
    "a start in words": ({"run.q0": "hom"}, "run", "q0 must be numbers, one per joint, or \"home\"; got 'hom'"),
    "a start with other joints": ({"run.q0": [1, 2, 3]}, "run", "q0 must have shape (2,) (2 joints) [rad | m]; got shape (3,)"),
    "a start with NaN": ({"run.v0": [NAN, 0]}, "run", "v0[0] (joint 'joint1') must be finite [rad/s | m/s]; got nan"),
    "a speed called home": ({"run.v0": "home"}, "run", "v0 must be a number or an array of numbers; got 'home'"),
    "a negative seed": ({"run.seed": -1}, "run", "seed must be a whole number >= 0; got -1"),
    "a seed with a comma": ({"run.seed": 0.5}, "run", "seed must be a whole number; got 0.5"),
    # [[event]]
    "an event without a time": ({"event": [{"set": {"law.kp": 1}}]}, "event 1", "needs the key 't'"),
    "an event before the start": ({"event": [{"t": -1, "set": {"law.kp": 1}}]}, "event 1", "t must be >= 0 [s]; got -1"),
    "an event after the end": (
        {"event": [{"t": 1.0, "set": {"law.kp": 1}}]},
        "event 1",
        "t: an event at t = 1 s would never act: the run ends at 0.05 s",
    ),
    "an event after all ends": ({"event": [{"t": 1e306, "set": {"law.kp": 1}}]}, "event 1", "t is too large"),
    "an event that sets a number": ({"event": [{"t": 0, "set": 3}]}, "event 1", "set must be a table such as { \"law.kp\" = 150.0 }; got 3"),
    "an event that sets nothing": ({"event": [{"t": 0, "set": {}}]}, "event 1", "set must be a table such as"),
    "an event without quotes": (
        {"event": [{"t": 0, "set": {"law": {"kp": 3}}}]},
        "event 1",
        "set must have each path in quotes, such as { \"law.kp\" = 150.0 }; got a table 'law'",
    ),
    "the second event on an unknown parameter": (
        {"event": [{"t": 0, "set": {"law.kp": 1}}, {"t": 0, "set": {"law.PD.kp": 1}}]},
        "event 2",
        "set: the loop has no parameter 'law.PD.kp'; did you mean 'law.kp'",
    ),
    "an event that one of the laws does not know": (
        {"laws.FF": {"law": "FeedForward"}, "event": [{"t": 0, "set": {"law.kp": 1}}]},
        "event 1",
        "set: the loop of the law 'FF' has no parameter 'law.kp'",
    ),
    "an event that sets and pushes": ({"event": [{"t": 0, "set": {"law.kp": 1}, "push": {}}]}, "event 1", "sets parameters or pushes; got both set and push; write two events\n"),
    "an event that pushes what nothing touches": ({"event": [{"t": 0, "push": {}}]}, "event 1", "set: the loop has no parameter 'environment.t'"),
    "an event that pushes for no time": ({"event": [{"t": 0, "push": {"duration": 0}}]}, "event 1.push", "duration must be > 0 [s]; got 0"),
    "an event that pushes in a plane": ({"event": [{"t": 0, "push": {"peak": [1, 2]}}]}, "event 1.push", "push.peak must be a force (3,) [N] or a wrench (6,)"),
    "an event that pushes a number": ({"event": [{"t": 0, "push": {"of": 3}}]}, "event 1.push", 'of must be the path of a push, such as "environment.push"; got 3'),
    "an event that pushes before the start": ({"event": [{"t": -1, "push": {}}]}, "event 1", "t must be >= 0 [s]; got -1"),
    "an event that pushes with a misspelt key": ({"event": [{"t": 0, "push": {"peek": 3}}]}, "event 1.push", "has no key 'peek'; did you mean 'peak'?"),
    "an event that sets a word": ({"event": [{"t": 0, "set": {"law.kp": "abc"}}]}, "event 1", "set: law.kp must be numbers"),
    "an event that sets a negative mass": (
        {"event": [{"t": 0, "set": {"plant.payload.mass": -1}}]},
        "event 1",
        "set: plant.payload.mass must be >= 0",
    ),
    "the same in MuJoCo": (
        {"plant.kind": "mujoco", "event": [{"t": 0, "set": {"plant.payload.mass": -1}}]},
        "event 1",
        "set: plant.payload.mass must be >= 0",
    ),
    # [outputs]
    "an unknown law to show": ({"outputs": {"shown": "x"}}, "outputs", "shown must be one of the laws 'PD'; got 'x'"),
    "a file that leaves the folder": ({"outputs": {"plot": "../x.png"}}, "outputs", "plot must be a file name ending in .png or .pdf or .svg"),
    "a file of another kind": ({"outputs": {"video": "x.avi"}}, "outputs", "video must be a file name ending in .gif or .mp4"),
    "a file without a name": ({"outputs": {"log": ".mcap"}}, "outputs", "log must be a file name ending in .mcap; got '.mcap'"),
    "a file with a name of 5000 letters": ({"outputs": {"csv": "a" * 5000 + ".csv"}}, "outputs", "csv must be a file name of at most 200 bytes; got 5004"),
    "a file with a zero in its name": ({"outputs": {"csv": "a\0.csv"}}, "", " has at 'outputs.csv' a text with an invisible character"),
    "a plot of nine laws": (
        {"laws": {f"law {i}": {"law": "PID", "kp": 1} for i in range(9)}, "outputs": {"plot": "x.png"}},
        "outputs",
        "plot draws at most 8 laws; got 9",
    ),
    # [[pass]]
    "an unknown law to pass": ({"pass": [{**PASS, "law": "PID"}]}, "pass 1", "law must be one of 'PD'; got 'PID'"),
    "an unknown metric": ({"pass": [PASS, {**PASS, "metric": "rms"}]}, "pass 2", "metric: a run has no metric 'rms'; it has"),
    "a pass figure without a bound": ({"pass": [{"law": "PD", "metric": "rms_error"}]}, "pass 1", "needs min, max or both"),
    "an unknown joint to pass": (
        {"pass": [{**PASS, "joint": "join1"}]},
        "pass 1",
        "joint: arm 'planar2' has no joint 'join1'; did you mean 'joint1'",
    ),
    "a joint that is a number": ({"pass": [{**PASS, "joint": 1}]}, "pass 1", "joint must be a text in quotes; got 1"),
    "a settling time of a motion": (
        {"reference": CUBIC, "pass": [{**PASS, "metric": "settling_time"}]},
        "pass 1",
        "metric 'settling_time' is for a set-point, and the [reference] moves; take one of 'rms_error', 'peak_error', ",
    ),
    "the overshoot of a set-point with a speed": (
        {"reference.v": [0.1, 0], "pass": [{**PASS, "metric": "overshoot"}]},
        "pass 1",
        "metric 'overshoot' is for a set-point, and the [reference] moves",
    ),
    "bounds that nothing reaches": ({"pass": [{**PASS, "min": 2}]}, "pass 1", "min must be <= max, which is 1; got 2"),
}  # fmt: skip


def toml(value: Any) -> str:
    """A value as inline TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, (str, bool)):
        return json.dumps(value)
    return repr(value)


def scenario(changes: dict[str, Any]) -> str:
    """The good scenario with some values changed."""
    table = copy.deepcopy(GOOD)
    for path, value in changes.items():
        *sections, key = path.split(".")
        at = table
        for name in sections:
            at = at[name]
        if value is GONE:
            del at[key]
        else:
            at[key] = value
    return "\n".join(f"{key} = {toml(value)}" for key, value in table.items())


def test_what_the_cases_change_is_a_good_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("case.toml").write_text(scenario({}))
    assert main(["run", "case.toml"]) == 0


@pytest.mark.parametrize("name", list(CASES))
def test_a_value_that_cannot_be_is_refused_with_file_section_and_key(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    changes, section, words = CASES[name]
    Path("case.toml").write_text(scenario(changes), encoding="utf-8")
    assert main(["run", "case.toml"]) == 2
    said = capsys.readouterr()
    place = f": [{section}] " if section else ""
    assert said.err.startswith(f"taut: scenario 'case.toml'{place}{words.replace('{folder}', str(tmp_path))}")
    assert said.err.count("\n") == 1
    assert said.out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["case.toml"]


NO_SCENARIO: dict[str, tuple[bytes, str]] = {
    "an empty file": (b"", "taut: scenario 'case.toml' is empty"),
    "no TOML": (b"title = 'open", "taut: scenario 'case.toml' is no valid TOML: "),
    "control characters": (b"\x00\x01", "taut: scenario 'case.toml' is no valid TOML: "),
    "no text": (b"title = '\xff\xfe'", "taut: scenario 'case.toml' is no UTF-8 text"),
    "deep brackets": (b"x = " + b"[" * 5000, "taut: scenario 'case.toml' is no valid TOML"),
    "deep tables": (
        b"title" + b".a" * 5000 + b" = 1",
        "taut: scenario 'case.toml' has at 'title.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a' more than 16 tables",
    ),
    "a number of 5000 digits": (b"title = " + b"9" * 5000, "taut: scenario 'case.toml' is no valid TOML: Exceeds the limit"),
    "a number of 5000 hexadecimal digits": (
        b"[run]\nduration = 0x" + b"f" * 5000,
        "taut: scenario 'case.toml' has at 'run.duration' a whole number beyond the 64 bits of TOML; write it as 1e20",
    ),
    "more than a page": (b"#" * 500_001, "taut: scenario 'case.toml' is larger than 500000 bytes"),
}  # fmt: skip


@pytest.mark.parametrize("name", list(NO_SCENARIO))
def test_a_file_that_is_no_scenario_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    data, words = NO_SCENARIO[name]
    Path("case.toml").write_bytes(data)
    assert main(["run", "case.toml"]) == 2
    said = capsys.readouterr()
    assert said.err.startswith(words)
    assert said.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["case.toml"]


NASTY: tuple[Any, ...] = (
    "x",
    "",
    "a\nb\x1b[31m",
    -1,
    0,
    1e300,
    NAN,
    INF,
    True,
    [],
    [[]],
    {},
    {"self": 1},
    [[1], [2, 3]],
    [NAN, 0.0],
)


@pytest.mark.parametrize("value", NASTY, ids=repr)
def test_whatever_stands_behind_a_key_ends_in_one_line_or_in_a_run(
    value: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    whole = {
        "arm.home": [0.1, 0.2], "arm.gravity": [0, 0, -9.81], "arm.payload": {"mass": 1.0, "com": [0, 0, 0.1]},
        "arm.joint_values": {"viscous": 0.1}, "control.limits": {"tau": 50.0, "tau_dot": 1e3}, "plant.adds": ["gravity"],
        "plant.substeps": 2, "plant.sensors": {"position": {"noise": 1e-5}}, "control.velocity": {"kind": "difference", "cutoff": 30.0}, "plant.actuation": {"delay": 0.002},
        "reference": {**CUBIC, "relative_to_home": True}, "run.q0": [0.0, 0.0], "run.seed": 1,
        "event": [{"t": 0.01, "set": {"plant.payload.mass": 2.0}}], "pass": [PASS],
    }  # fmt: skip
    for path in [
        *whole,
        "title",
        "laws.PD.kp",
        "laws.PD.law",
        "control.rate",
        "plant.kind",
        "run.duration",
        "run",
        "arm",
    ]:
        if value == 1e300 and path in ("laws.PD.kp", "arm.joint_values"):
            continue  # a run, which diverges
        Path("case.toml").write_text(scenario({**whole, path: value}), encoding="utf-8")
        status = main(["run", "case.toml", "--engine", "float"])
        said = capsys.readouterr()
        if status == 2:
            assert said.err.startswith("taut: scenario 'case.toml'"), path
            assert said.err.count("\n") == 1, path
        else:
            assert said.err == "", path
