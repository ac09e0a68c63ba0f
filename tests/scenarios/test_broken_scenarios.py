"""Every value that a scenario cannot have is refused in one sentence about its key; nothing is written."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

import taut
from taut.cli.main import main
from taut.scenarios.scenario import load_scenario

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
LEARN = {"kind": "learning", "by": {"kind": "norm-optimal"}}
EXCITE = {"kind": "identification", "duration": 10.0, "what": ["friction"]}
LINK = {"kind": "flexible-link", "length": 1.0, "EI": 5.0, "density": 0.5, "hub_inertia": 0.1}
NAN, INF = float("nan"), float("inf")

# What is changed, by dotted path, and the path of the key that is refused; of the section, where it is all of it.
CASES: dict[str, tuple[dict[str, Any], str]] = {
    # the file as a whole
    "a misspelt section": ({"control": GONE, "contrl": {}}, "contrl"),
    "a section that is no table": ({"control": 500}, "control"),
    "no plant": ({"plant": GONE}, "plant"),
    "no run": ({"run": GONE}, "run"),
    "a title that is a number": ({"title": 3}, "title"),
    "events that are a table": ({"event": {"t": 1}}, "event"),
    # [arm]
    "no model": ({"arm": {}}, "arm.model"),
    "an unknown arm": ({"arm.model": "planer2"}, "arm.model"),
    "an arm that is a file elsewhere": ({"arm.model": "no/such.urdf"}, "arm.model"),
    "a model with a name of 5000 letters": ({"arm.model": "/" + "a" * 5000 + ".urdf"}, "arm.model"),
    "a model without a name": ({"arm.model": ""}, "arm.model"),
    "an unknown tool": ({"arm.tool": "tol"}, "arm.tool"),
    "a pose with two angles": ({"arm.T_WB": {"rpy": [1, 2]}}, "arm.T_WB.rpy"),
    "a pose with two rotations": ({"arm.T_WB": {"rpy": [0, 0, 0], "xyzw": [0, 0, 0, 1]}}, "arm.T_WB.rpy"),
    "a pose that is an array": ({"arm.T_WB": [1, 2, 3]}, "arm.T_WB"),
    "gravity in a plane": ({"arm.gravity": [0, 0]}, "arm.gravity"),
    "a home pose in words": ({"arm.home": "up"}, "arm.home"),
    "locked joints in words": ({"arm.locked": "joint1"}, "arm.locked"),
    "an unknown joint to lock": ({"arm.locked": {"joint9": 0}}, "arm.locked"),
    "an unknown joint to keep": ({"arm.joints": ["joint9"]}, "arm.joints"),
    "joints that are a number": ({"arm.joints": 3}, "arm.joints"),
    "an unknown body": ({"arm.bodies": {"joint9": {"mass": 1}}}, "arm.bodies.joint9"),
    "a body without a mass": ({"arm.bodies": {"joint1": {"mass": "x"}}}, "arm.bodies.joint1.mass"),
    "an unknown joint value": ({"arm.joint_values": {"viscus": [1, 2]}}, "arm.joint_values.viscus"),
    "a joint value called self": ({"arm.joint_values": {"self": 1}}, "arm.joint_values.self"),
    "a payload without a mass": ({"arm.payload": {"com": [0, 0, 0]}}, "arm.payload.mass"),
    "a misspelt mass": ({"arm.payload": {"mas": 1}}, "arm.payload.mas"),
    "a payload of negative mass": ({"arm.payload": {"mass": -1}}, "arm.payload.mass"),
    "a link for another arm": ({"arm.link": {"r": 0.1}}, "arm.link"),
    "a misspelt number of the link": ({"arm": {"model": "one_joint", "link": {"R": 0.1}}}, "arm.link.R"),
    # [laws]
    "no laws": ({"laws": {}}, "laws"),
    "a law that is a number": ({"laws.PD": 3}, "laws.PD"),
    "an unknown law": ({"laws.PD.law": "PDI"}, "laws.PD.law"),
    "a law's name that is a number": ({"laws.PD.law": 3}, "laws.PD.law"),
    "a sum with a number": ({"laws.PD.law": [3]}, "laws.PD.law"),
    "a sum of nothing": ({"laws.PD.law": []}, "laws.PD.law"),
    "a sum with a law twice": ({"laws.PD": {"law": ["PID", "PID"], "PID": {"kp": 1}}}, "laws.PD.law"),
    "a sum that adds gravity twice": ({"laws.PD": {"law": ["GravityPID", "GravityCompensation"], "GravityPID": {"kp": 1, "kd": 1}}}, "laws.PD.law"),
    "a law in a wrapper of other laws": ({"laws.PD.wrapped_by": {"law": "LossOfContact"}}, "laws.PD.wrapped_by.law"),
    "friction by joint name": ({"plant.friction": {"coulomb": {"joint2": 0.3}}}, "plant.friction.coulomb"),
    "a sum without gains": ({"laws.PD": {"law": ["FeedForward", "PID"]}}, "laws.PD.PID.kp"),
    "a misspelt gain that must be there": ({"laws.PD": {"law": "PID", "kpp": 1}}, "laws.PD.kpp"),
    "a misspelt gain": ({"laws.PD.kdd": 1}, "laws.PD.kdd"),
    "a negative gain": ({"laws.PD.kp": -1}, "laws.PD.kp"),
    "a gain that is NaN": ({"laws.PD.kp": NAN}, "laws.PD.kp"),
    "a gain that is true": ({"laws.PD.kp": True}, "laws.PD.kp"),
    "a gain of another size": ({"laws.PD.kp": [1, 2, 3]}, "laws.PD.kp"),
    "a law that holds none": ({"laws.PD": {"law": "RaisedGains", "factor": 2}}, "laws.PD.inner"),
    "a law that holds an unknown one": ({"laws.PD": {"law": "RaisedGains", "factor": 2, "inner": {"law": "PDI"}}}, "laws.PD.inner.law"),
    "a misspelt gain of a law that is held": ({"laws.PD": {"law": "RaisedGains", "factor": 2, "inner": {"law": "PID", "kp": 1, "kdd": 1}}}, "laws.PD.inner.kdd"),
    "a dither that is too fast": ({"laws.PD": {"law": "Dither", "amplitude": 1, "frequency": 900}}, "laws.PD.frequency"),
    # [control]
    "a rate of zero": ({"control.rate": 0}, "control.rate"),
    "an endless rate": ({"control.rate": INF}, "control.rate"),
    "a rate that is text": ({"control.rate": "fast"}, "control.rate"),
    "a rate that no controller has": ({"control.rate": 1e9}, "control.rate"),
    "a rate in seconds": ({"control.rate": 0.001}, "control.rate"),
    "a run of no period": ({"run.duration": 1e-4}, "run.duration"),
    "another velocity": ({"control.velocity": "diff"}, "control.velocity"),
    "the kinds of velocity": ({"control.velocity": 80}, "control.velocity"),
    "sensing in its own table": ({"control.sensing": {"velocity": "difference"}}, "control.sensing"),
    "limits of an arm that states none": ({"control.limits": "arm"}, "control.limits"),
    "misspelt limits": ({"control.limits": {"taus": 1}}, "control.limits.taus"),
    "limits of nothing": ({"control.limits": {}}, "control.limits"),
    "a blend of no time": ({"control.limits": {"blend": 0}}, "control.limits.blend"),
    "limits of another arm": ({"control.limits": {"of": "robot"}}, "control.limits.of"),
    "a gain without a speed limit": ({"control.limits": {"tau": 1, "v_gain": 5}}, "control.limits.v_gain"),
    "a speed limit faster than the rate": ({"control.limits": {"v": 1, "v_gain": 5000}, "control.rate": 100}, "control.limits.v_gain"),
    "limits of another size": ({"control.limits": {"tau": [1, 2, 3]}}, "control.limits.tau"),
    "negative limits": ({"control.limits": {"tau": -1}}, "control.limits.tau"),
    "a velocity without its numbers": ({"control.velocity": "kalman"}, "control.velocity"),
    "another kind of velocity": ({"control.velocity": {"kind": "median"}}, "control.velocity.kind"),
    "a velocity of no kind": ({"control.velocity": {"cutoff": 30}}, "control.velocity.kind"),
    "a low-pass without a cut-off": ({"control.velocity": {"kind": "low-pass"}}, "control.velocity.cutoff"),
    "a key of another velocity": ({"control.velocity": {"kind": "kalman", "cutoff": 3}}, "control.velocity.cutoff"),
    "a cut-off of zero": ({"control.velocity": {"kind": "difference", "cutoff": 0}}, "control.velocity.cutoff"),
    "a cut-off above half the rate": ({"control.velocity": {"kind": "low-pass", "cutoff": [30, 600]}}, "control.velocity.cutoff"),
    "an order that there is not": ({"control.velocity": {"kind": "low-pass", "cutoff": 3, "order": 3}}, "control.velocity.order"),
    "a notch without a width": ({"control.notch": {"frequency": 18}}, "control.notch.width"),
    "a notch in words": ({"control.notch": "18 Hz"}, "control.notch"),
    "a filter of what no law uses": ({"control.F_ext": {"cutoff": 30}}, "control.F_ext"),
    "a wrist that no law reads": ({"control.wrist": {"mass": 0.7}}, "control.wrist"),
    "a misspelt mass of a tool": ({"control.wrist": {"mas": 0.7}}, "control.wrist.mas"),
    "a centre without a mass": ({"control.wrist": {"com": [0, 0, 0.1]}}, "control.wrist.com"),
    "one number for force and moment": ({"control.wrist": {"bias": 1}}, "control.wrist.bias"),
    "a tool of negative mass": ({"plant.sensors": {"wrench": {"tool": {"mass": -1}}}}, "plant.sensors.wrench.tool.mass"),
    "a tool in words": ({"plant.sensors": {"wrench": {"tool": "gripper"}}}, "plant.sensors.wrench.tool"),
    "a wrist sensor on another link": ({"plant.sensors": {"wrench": {"tool": {"mass": 1}, "frame": "link1"}}}, "plant"),
    "limits of a velocity": ({"control.limits": {"tau": 1}, "laws.PD": {"law": "VelocityPI", "kp": 1}, "plant": VELOCITY}, "control.limits"),
    # [plant]
    "another kind of plant": ({"plant.kind": "soft"}, "plant.kind"),
    "a plant with other joints": ({"plant.model": "planar3"}, "plant.model"),
    "an unknown plant": ({"plant.model": "planar33"}, "plant.model"),
    "adds that is a number": ({"plant.adds": 3}, "plant.adds"),
    "adds that is a text": ({"plant.adds": "gravity"}, "plant.adds"),
    "adds with a number": ({"plant.adds": [1]}, "plant.adds"),
    "an unknown thing to add": ({"plant.adds": ["weight"]}, "plant.adds"),
    "an unknown integrator": ({"plant.integrator": "euler"}, "plant.integrator"),
    "no substeps": ({"plant.substeps": 0}, "plant.substeps"),
    "half a substep": ({"plant.substeps": 0.5}, "plant.substeps"),
    "another command": ({"plant.takes": "power"}, "plant.takes"),
    "a command that the law does not give": ({"plant": VELOCITY}, "plant.takes"),
    "drives of MuJoCo without a bandwidth": ({"plant": {"kind": "mujoco", "takes": "velocity"}}, "plant"),
    "drives of MuJoCo that are too fast": ({"plant": {"kind": "mujoco", "takes": "velocity", "actuation": {"bandwidth": 200.0}}}, "plant.actuation.bandwidth"),
    "drives without a bandwidth": ({"plant.takes": "velocity"}, "plant"),
    "a delay between ticks": ({"plant.actuation": {"delay": 0.0015}}, "plant.actuation.delay"),
    "a delay that no number holds": ({"plant.actuation": {"delay": 1e306}}, "plant.actuation"),
    "a misspelt delay": ({"plant.actuation": {"dely": 1}}, "plant.actuation.dely"),
    "noise for other joints": ({"plant.sensors": {"position": {"noise": [1, 2, 3]}}}, "plant.sensors.position.noise"),
    "noise in words": ({"plant.sensors": {"position": {"noise": "a"}}}, "plant.sensors.position.noise"),
    "noise of no sensor": ({"plant.sensors": {"noise": 1e-3}}, "plant.sensors.noise"),
    "no position sensor": ({"plant.sensors": {"position": "none"}}, "plant.sensors.position"),
    "a resolution of zero": ({"plant.sensors": {"position": {"resolution": 0}}}, "plant.sensors.position.resolution"),
    "an encoder on another side": ({"plant.sensors": {"position": {"side": "both"}}}, "plant.sensors.position.side"),
    "a second encoder at the link": ({"plant.sensors": {"motor": {"side": "link"}}}, "plant.sensors.motor"),
    "a wrench sensor where nothing touches": ({"plant.sensors": {"wrench": {"range": [100, 10]}}}, "plant.sensors"),
    "no tachometer": ({"plant.sensors": {"velocity": "none"}}, "plant"),
    "a perturbed arm without a seed": ({"plant.perturbed": {"mass": 0.1}}, "plant.perturbed.seed"),
    "a perturbed arm with a negative seed": ({"plant.perturbed": {"seed": -1}}, "plant.perturbed.seed"),
    "a key of MuJoCo": ({"plant.timestep": 0.001}, "plant.timestep"),
    "a key of a rigid plant": ({"plant": {"kind": "mujoco", "substeps": 2}}, "plant.substeps"),
    # joints: friction, gears, drives
    "an unknown number of friction": ({"plant.friction": {"coulom": 1}}, "plant.friction.coulom"),
    "another friction": ({"plant.friction": "some"}, "plant.friction"),
    "friction that is a number": ({"plant.friction": 3}, "plant.friction"),
    "the arm's friction in another word": ({"arm.friction": "arm"}, "arm.friction"),
    "negative friction": ({"arm.friction": {"coulomb": [1, -1]}}, "arm.friction.coulomb"),
    "friction for other joints": ({"plant.friction": {"viscous": [1, 2, 3]}}, "plant.friction.viscous"),
    "less friction at rest than in motion": ({"plant.friction": {"coulomb": 1, "static": [1, 0.5]}}, "plant.friction.static"),
    "gears without a ratio": ({"plant.gears": {"motor_inertia": 1e-4}}, "plant.gears.ratio"),
    "gears without a rotor": ({"plant.gears": {"ratio": 100}}, "plant.gears.motor_inertia"),
    "gears that are a number": ({"plant.gears": 100}, "plant.gears"),
    "a negative ratio": ({"plant.gears": {"ratio": -1, "motor_inertia": 1e-4}}, "plant.gears.ratio"),
    "gears of two joints": ({"arm.gears": {"ratio": {"joint1": 10}, "motor_inertia": {"joint2": 1e-4}}}, "arm.gears.motor_inertia"),
    "gears of an unknown joint": ({"plant.gears": {"ratio": {"joint9": 10}, "motor_inertia": 1e-4}}, "plant.gears.ratio"),
    "gears with a loss": ({"plant.gears": {"ratio": 1, "motor_inertia": 1e-4, "efficiency": 1}}, "plant.gears.efficiency"),
    "a negative rotor": ({"plant.joint_values": {"rotor_inertia": -1}}, "plant.joint_values.rotor_inertia"),
    "rotors for other joints": ({"plant.joint_values": {"rotor_inertia": [1, 2, 3]}}, "plant.joint_values.rotor_inertia"),
    "a rotor of an unknown joint": ({"plant.joint_values": {"rotor_inertia": {"j": 1}}}, "plant.joint_values.rotor_inertia"),
    "misspelt gears": ({"plant.geers": 1}, "plant.geers"),
    "a motor of two kinds": ({"plant.actuation": {"motor": {"peak": 1, "resistance": 1}}}, "plant.actuation.motor.peak"),
    "a spring too stiff for MuJoCo's steps": ({
            "plant.kind": "mujoco",
            "plant.gears": {"ratio": 100, "motor_inertia": 1e-6},
            "plant.actuation": {"transmission": {"stiffness": 5e4}},
        }, "plant.timestep"),
    "half a curve": ({"plant.actuation": {"motor": {"stall": 1}}}, "plant.actuation.motor"),
    "an electric motor without a constant": ({"plant.actuation": {"motor": {"resistance": 1}}}, "plant.actuation.motor.torque_constant"),
    "a misspelt resistance": ({"plant.actuation": {"motor": {"resistence": 1}}}, "plant.actuation.motor.resistence"),
    "a negative peak": ({"plant.actuation": {"motor": {"peak": [1, -1]}}}, "plant.actuation.motor.peak"),
    "a peak for other joints": ({"plant.actuation": {"motor": {"peak": [1, 1, 1]}}}, "plant.actuation.motor.peak"),
    "a motor in words": ({"plant.actuation": {"motor": "dc"}}, "plant.actuation.motor"),
    "half a ripple": ({"plant.actuation": {"ripple": {"amplitude": 0.1}}}, "plant.actuation.ripple.periods"),
    "gears that give back more": ({"plant.actuation": {"transmission": {"efficiency": 1.5}}}, "plant.actuation.transmission.efficiency"),
    "play without teeth": ({"plant.actuation": {"transmission": {"backlash": 0.01}}}, "plant.actuation.transmission.backlash"),
    "elasticity without a rotor": ({"plant.actuation": {"transmission": {"stiffness": 1e3}}}, "plant"),
    "a spring that is too fast": ({"plant": {"joint_values": {"rotor_inertia": 1.0}, "actuation": {"transmission": {"stiffness": 1e9}}}}, "plant"),
    "a torque loop without gains": ({"plant.actuation": {"torque_loop": {}}}, "plant.actuation.torque_loop"),
    "an account of energy that is a number": ({"plant.energy": 1}, "plant.energy"),
    "drives of MuJoCo with a delay between ticks": ({"plant": {"kind": "mujoco", "actuation": {"delay": 0.0015}}}, "plant.actuation.delay"),
    "an environment that is a word": ({"plant.environment": "wall"}, "plant.environment"),
    "an environment without a kind": ({"plant.environment": {"stiffness": 3}}, "plant.environment.kind"),
    "an empty environment": ({"plant.environment": {}}, "plant.environment.kind"),
    "an unknown environment": ({"plant.environment": {"kind": "wal"}}, "plant.environment.kind"),
    "one of several without a kind": ({"plant.environment": {"a": {"peak": [1, 0, 0]}}}, "plant.environment.a.kind"),
    "a misspelt stiffness": ({"plant.environment": {"kind": "spring", "stifness": 1}}, "plant.environment.stifness"),
    "a spring without a stiffness": ({"plant.environment": {"kind": "spring"}}, "plant.environment.stiffness"),
    "a spring at a place with two rotations": ({"plant.environment": {"kind": "spring", "stiffness": 1, "at": {"rpy": [0, 0, 0], "xyzw": [0, 0, 0, 1]}}}, "plant.environment.at.rpy"),
    "a negative damping": ({"plant.environment": {"kind": "damper", "damping": -1}}, "plant.environment.damping"),
    "a wall that is too stiff": ({"plant.environment": {"kind": "wall", "point": [0, 0, -1], "normal": [0, 0, 1], "stiffness": 1e8}}, "plant.environment"),
    "a wall that is too stiff in MuJoCo": ({"plant": {"kind": "mujoco", "environment": {"kind": "wall", "point": [0, 0, -1], "normal": [0, 0, 1], "stiffness": 1e8}}}, "plant.environment"),
    "a hand that wants a word": ({"plant.environment": {"kind": "hand", "mass": 1, "damping": 1, "stiffness": 1, "motion": "wave"}}, "plant.environment.motion"),
    "a hand with an unknown motion": ({"plant.environment": {"kind": "hand", "mass": 1, "damping": 1, "stiffness": 1, "motion": {"kind": "sine"}}}, "plant.environment.motion.kind"),
    "a push in a plane": ({"plant.environment": {"kind": "push", "peak": [1, 2]}}, "plant.environment.peak"),
    # [cases]
    "cases that are a number": ({"cases": 3}, "cases"),
    "no cases": ({"cases": {}}, "cases"),
    "a case that is a number": ({"cases": {"a": 3}}, "cases.a"),
    "a case without a name": ({"cases": {"": {}}}, "cases"),
    "a misspelt section of a case": ({"cases": {"a": {"pland": {}}}}, "cases.a.pland"),
    "a case with a title": ({"cases": {"a": {"title": "x"}}}, "cases.a.title"),
    "a case with a law of its own": ({"cases": {"a": {"laws": {"PID": {"kp": 1}}}}}, "cases.a"),
    "a wrong value in the second case": ({"cases": {"a": {}, "b": {"plant": {"substeps": 0}}}}, "plant.substeps"),
    "a case in which a law does not fit": ({"cases": {"a": {"laws": {"PD": {"kp": [1, 2, 3]}}}}}, "laws.PD.kp"),
    "a case with another arm": ({"cases": {"a": {"arm": {"model": "planar3"}}}}, "reference.q"),
    "a case that puts a number for a table": ({"cases": {"a": {"plant": 3}}}, "plant"),
    "a pass criterion of an unknown case": ({"cases": {"a": {}}, "pass": [{**PASS, "case": "b"}]}, "pass 1.case"),
    "a pass criterion of a case where there are none": ({"pass": [{**PASS, "case": "b"}]}, "pass 1.case"),
    "an unknown case to show": ({"cases": {"a": {}}, "outputs": {"shown_case": "b"}}, "outputs.shown_case"),
    "an unknown metric to show": ({"outputs": {"columns": ["rms"]}}, "outputs.columns"),
    "no metric to show": ({"outputs": {"columns": []}}, "outputs.columns"),
    "a metric to show twice": ({"outputs": {"columns": ["effort", "effort"]}}, "outputs.columns"),
    "metrics in one text": ({"outputs": {"columns": "effort"}}, "outputs.columns"),
    "an unknown joint to show": ({"outputs": {"joint": "joint3"}}, "outputs.joint"),
    "a smooth integrator with dry friction": ({"plant": {"integrator": "rk4", "joint_values": {"coulomb": [1, 1]}}}, "plant.integrator"),
    "a plant that is a file elsewhere": ({"plant.model": "no.urdf"}, "plant.model"),
    "a scene that is not there": ({"plant": {"kind": "mujoco", "scene": "no.xml"}}, "plant.scene"),
    "a scene that is not there, with its whole path": ({"plant": {"kind": "mujoco", "scene": "/no/such.xml"}}, "plant.scene"),
    "a time step that does not fit": ({"plant": {"kind": "mujoco", "timestep": 0.0007}}, "plant.timestep"),
    "a time step of zero": ({"plant": {"kind": "mujoco", "timestep": 0.0}}, "plant.timestep"),
    "a time step for years": ({"plant": {"kind": "mujoco", "timestep": 1e-9}}, "plant.timestep"),
    # [reference]
    "another kind of reference": ({"reference.kind": "spiral"}, "reference.kind"),
    "a reference without a kind": ({"reference": {"q": [0, 0]}}, "reference.kind"),
    "a reference for other joints": ({"reference.q": [0.1]}, "reference.q"),
    "the same from home": ({"reference": {"kind": "set-point", "q": [0.1], "relative_to_home": True}}, "reference.q"),
    "a reference that is a number": ({"reference.q": 0.1}, "reference.q"),
    "a reference in words": ({"reference.q": "hom"}, "reference.q"),
    "words from home": ({"reference": {"kind": "set-point", "q": "a", "relative_to_home": True}}, "reference.q"),
    "a ragged reference from home": ({"reference": {"kind": "set-point", "q": [[1], [2, 3]], "relative_to_home": True}}, "reference.q"),
    "a reference with NaN": ({"reference.q": [0.2, NAN]}, "reference.q"),
    "a hold from home": ({"reference": {"kind": "hold", "relative_to_home": True}}, "reference.relative_to_home"),
    "a start for other joints": ({"reference": {**CUBIC, "q0": [1, 2, 3]}}, "reference.q0"),
    "scalars for all joints": ({"reference": {**CUBIC, "q0": 0, "q1": 1}}, "reference.q0"),
    "a motion that takes no time": ({"reference": {**CUBIC, "duration": 0}}, "reference.duration"),
    "a motion that is faster than numbers": ({"reference": {**CUBIC, "duration": 1e-300}}, "reference.duration"),
    "a missing limit": ({"reference": JERK}, "reference.jerk"),
    "a misspelt limit": ({"reference": {**JERK, "jrk": 1}}, "reference.jrk"),
    "a key of another trajectory": ({"reference": {**CUBIC, "velocity": 1}}, "reference.velocity"),
    "times that go back": ({"reference": {**SPLINE, "times": [1.0, 0.0]}}, "reference.times"),
    "points for other joints": ({"reference": {**SPLINE, "points": [[0.0], [1.0]]}}, "reference.points"),
    "samples that are not there": ({"reference": {"kind": "samples", "file": "no.csv"}}, "reference.file"),
    # [preparation]
    "a preparation without a kind": ({"preparation": {"trials": 3}}, "preparation.kind"),
    "an unknown preparation": ({"preparation": {"kind": "learing"}}, "preparation.kind"),
    "learning by no law": ({"preparation": {"kind": "learning"}}, "preparation.by"),
    "learning by an unknown law": ({"preparation": {**LEARN, "by": {"kind": "optimal"}}}, "preparation.by.kind"),
    "learning gains of another arm": ({"preparation": {**LEARN, "by": {"kind": "pd", "Lp": [1, 2, 3]}}}, "preparation.by.Lp"),
    "a misspelt learning gain": ({"preparation": {**LEARN, "by": {"kind": "pd", "lp": 1}}}, "preparation.by.lp"),
    "no trials": ({"preparation": {**LEARN, "trials": 0}}, "preparation.trials"),
    "half a trial": ({"preparation": {**LEARN, "trials": 2.5}}, "preparation.trials"),
    "a lead of learning": ({"preparation": {**LEARN, "lead": 0.1}}, "preparation.lead"),
    "trials of an hour": ({"preparation": LEARN, "run.duration": 3600.0}, "preparation"),
    "inversion without a lead": ({"preparation": {"kind": "inversion"}}, "preparation.lead"),
    "a negative lead": ({"preparation": {"kind": "inversion", "lead": -0.1}}, "preparation.lead"),
    "a lead of an hour": ({"preparation": {"kind": "inversion", "lead": 3600.0}}, "preparation"),
    "an excitation of no whole period": ({"preparation": {**EXCITE, "duration": 7.0}}, "preparation.duration"),
    "an excitation of a day": ({"preparation": {**EXCITE, "duration": 86400.0}}, "preparation"),
    "an excitation of a million harmonics": ({"preparation": {**EXCITE, "harmonics": 1_000_000}}, "preparation.harmonics"),
    "identification of the unknown": ({"preparation": {**EXCITE, "what": ["mass"]}}, "preparation.what"),
    "a misspelt amplitude": ({"preparation": {**EXCITE, "amplitud": 0.3}}, "preparation.amplitud"),
    "a preparation of a law of the tool": (
        {"laws.PD": {"law": "TaskComputedTorque", "kp": 100, "kd": 20}, "reference": {"kind": "hold"}, "preparation": LEARN},
        "preparation",
    ),
    # a flexible link
    "a flexible link without a length": ({"plant": {k: v for k, v in LINK.items() if k != "length"}}, "plant.length"),
    "a flexible link with a payload": ({"plant": {**LINK, "payload": {"mass": 1.0}}}, "plant.payload"),
    "a flexible link for two joints": ({"plant": LINK}, "plant"),
    "modes that are too fast for the steps": ({"plant": {**LINK, "EI": 1e6, "substeps": 1}}, "plant.substeps"),
    # [run]
    "a missing duration": ({"run": {}}, "run.duration"),
    "a misspelt duration": ({"run": {"duraton": 1}}, "run.duraton"),
    "a negative duration": ({"run.duration": -1}, "run.duration"),
    "a duration of zero": ({"run.duration": 0}, "run.duration"),
    "a duration of ages": ({"run.duration": 1e12}, "run.duration"),
    "an endless duration": ({"run.duration": INF}, "run.duration"),
    "a duration in words": ({"run.duration": "x"}, "run.duration"),
    "a start in words": ({"run.q0": "hom"}, "run.q0"),
    "a start with other joints": ({"run.q0": [1, 2, 3]}, "run.q0"),
    "a start with NaN": ({"run.v0": [NAN, 0]}, "run.v0"),
    "a speed called home": ({"run.v0": "home"}, "run.v0"),
    "a negative seed": ({"run.seed": -1}, "run.seed"),
    "a seed with a comma": ({"run.seed": 0.5}, "run.seed"),
    # [[event]]
    "an event without a time": ({"event": [{"set": {"law.kp": 1}}]}, "event 1.t"),
    "an event before the start": ({"event": [{"t": -1, "set": {"law.kp": 1}}]}, "event 1.t"),
    "an event after the end": ({"event": [{"t": 1.0, "set": {"law.kp": 1}}]}, "event 1.t"),
    "an event after all ends": ({"event": [{"t": 1e306, "set": {"law.kp": 1}}]}, "event 1.t"),
    "an event that sets a number": ({"event": [{"t": 0, "set": 3}]}, "event 1.set"),
    "an event that sets nothing": ({"event": [{"t": 0, "set": {}}]}, "event 1.set"),
    "an event without quotes": ({"event": [{"t": 0, "set": {"law": {"kp": 3}}}]}, "event 1.set"),
    "the second event on an unknown parameter": ({"event": [{"t": 0, "set": {"law.kp": 1}}, {"t": 0, "set": {"law.PD.kp": 1}}]}, "event 2.set"),
    "an event that one of the laws does not know": ({"laws.FF": {"law": "FeedForward"}, "event": [{"t": 0, "set": {"law.kp": 1}}]}, "event 1.set"),
    "an event that sets and pushes": ({"event": [{"t": 0, "set": {"law.kp": 1}, "push": {}}]}, "event 1.set"),
    "an event that pushes what nothing touches": ({"event": [{"t": 0, "push": {}}]}, "event 1.push.of"),
    "an event that pushes for no time": ({"event": [{"t": 0, "push": {"duration": 0}}]}, "event 1.push.of"),
    "an event that pushes in a plane": ({"event": [{"t": 0, "push": {"peak": [1, 2]}}]}, "event 1.push.peak"),
    "an event that pushes a number": ({"event": [{"t": 0, "push": {"of": 3}}]}, "event 1.push.of"),
    "an event that pushes before the start": ({"event": [{"t": -1, "push": {}}]}, "event 1.push.t"),
    "an event that pushes with a misspelt key": ({"event": [{"t": 0, "push": {"peek": 3}}]}, "event 1.push.peek"),
    "an event that sets a word": ({"event": [{"t": 0, "set": {"law.kp": "abc"}}]}, "event 1.set"),
    "an event that sets a negative mass": ({"event": [{"t": 0, "set": {"plant.payload.mass": -1}}]}, "event 1.set"),
    "the same in MuJoCo": ({"plant.kind": "mujoco", "event": [{"t": 0, "set": {"plant.payload.mass": -1}}]}, "event 1.set"),
    # [outputs]
    "an unknown law to show": ({"outputs": {"shown": "x"}}, "outputs.shown"),
    "a file that leaves the folder": ({"outputs": {"plot": "../x.png"}}, "outputs.plot"),
    "a file of another kind": ({"outputs": {"video": "x.avi"}}, "outputs.video"),
    "a file without a name": ({"outputs": {"log": ".mcap"}}, "outputs.log"),
    "a file with a name of 5000 letters": ({"outputs": {"log": "a" * 5000 + ".mcap"}}, "outputs.log"),
    "a file with a zero in its name": ({"outputs": {"log": "a\0.mcap"}}, ""),
    # [[pass]]
    "an unknown law to pass": ({"pass": [{**PASS, "law": "PID"}]}, "pass 1.law"),
    "an unknown metric": ({"pass": [PASS, {**PASS, "metric": "rms"}]}, "pass 2.metric"),
    "a pass criterion without a bound": ({"pass": [{"law": "PD", "metric": "rms_error"}]}, "pass 1"),
    "an unknown joint to pass": ({"pass": [{**PASS, "joint": "join1"}]}, "pass 1.joint"),
    "a joint that is a number": ({"pass": [{**PASS, "joint": 1}]}, "pass 1.joint"),
    "bounds that nothing reaches": ({"pass": [{**PASS, "min": 2}]}, "pass 1.min"),
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
def test_a_value_that_cannot_be_is_refused_by_its_path_in_one_sentence(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    changes, path = CASES[name]
    Path("case.toml").write_text(scenario(changes), encoding="utf-8")
    with pytest.raises(taut.errors.ScenarioError) as caught:
        load_scenario("case.toml")
    assert caught.value.name == path
    text = str(caught.value)
    assert text.startswith("scenario 'case.toml'")
    assert "\n" not in text
    section, _, key = path.rpartition(".")
    assert not path or f"[{path}]" in text or (key in text and (f"[{section}]" in text or not section))
    assert [each.name for each in tmp_path.iterdir()] == ["case.toml"]


def test_the_command_line_prints_the_sentence_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("case.toml").write_text(scenario({"plant.substeps": 0}), encoding="utf-8")
    assert main(["run", "case.toml"]) == 2
    said = capsys.readouterr()
    assert said.err == "taut: scenario 'case.toml': [plant] substeps must be a whole number from 1 to 1000; got 0\n"
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
def test_whatever_stands_behind_a_key_is_refused_in_one_line_or_read(
    value: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    whole = {
        "arm.home": [0.1, 0.2], "arm.gravity": [0, 0, -9.81], "arm.payload": {"mass": 1.0, "com": [0, 0, 0.1]},
        "arm.joint_values": {"viscous": 0.1}, "control.limits": {"tau": 50.0, "tau_dot": 1e3}, "plant.adds": ["gravity"],
        "plant.substeps": 2, "plant.sensors": {"position": {"noise": 1e-5}}, "control.velocity": {"kind": "difference", "cutoff": 30.0}, "plant.actuation": {"delay": 0.002},
        "reference": {**CUBIC, "relative_to_home": True}, "run.q0": [0.0, 0.0], "run.seed": 1,
        "event": [{"t": 0.01, "set": {"plant.payload.mass": 2.0}}], "pass": [PASS],
    }  # fmt: skip
    more = ("title", "laws.PD.kp", "laws.PD.law", "control.rate", "plant.kind", "run.duration", "run", "arm")
    for path in (*whole, *more):
        Path("case.toml").write_text(scenario({**whole, path: value}), encoding="utf-8")
        text = "scenario 'case.toml' is read"
        try:
            load_scenario("case.toml")
        except taut.errors.ScenarioError as refusal:
            text = str(refusal)
        assert text.startswith("scenario 'case.toml'"), path
        assert "\n" not in text, path


OF_PREPARATIONS = {
    "learning": ({**LEARN, "by": {"kind": "pd", "Lp": 1.0, "cutoff": 10.0}}, ("by", "trials", "kind")),
    "identification": (EXCITE, ("what", "duration", "frequency", "amplitude", "harmonics", "speed", "acceleration", "seed")),
    "inversion": ({"kind": "inversion", "lead": 0.1}, ("lead",)),
}  # fmt: skip


@pytest.mark.parametrize("value", NASTY, ids=repr)
@pytest.mark.parametrize("kind", OF_PREPARATIONS)
def test_whatever_a_preparation_has_is_refused_in_one_line_or_read(
    kind: str, value: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    good, keys = OF_PREPARATIONS[kind]
    tables = [{**good, key: value} for key in keys]
    if kind == "learning":
        tables += [{**good, "by": {**good["by"], key: value}} for key in ("kind", "Lp", "Ld", "cutoff", "order")]
    for table in tables:
        Path("case.toml").write_text(scenario({"preparation": table}), encoding="utf-8")
        text = "scenario 'case.toml' is read"
        try:
            load_scenario("case.toml")
        except taut.errors.ScenarioError as refusal:
            text = str(refusal)
        assert text.startswith("scenario 'case.toml'"), table
        assert "\n" not in text, table
