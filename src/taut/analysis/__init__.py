"""Analyses of loops and runs: stiffness, constraints, design, diagnosis, comparison, tuning."""

from __future__ import annotations

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.analysis.compare.compare import Comparison as Comparison
    from taut.analysis.compare.grading import Grade as Grade
    from taut.analysis.compare.truth import WrongModel as WrongModel
    from taut.analysis.constraints.admissible import Admissible as Admissible
    from taut.analysis.constraints.contact_modes import FrictionMargin as FrictionMargin
    from taut.analysis.constraints.freedom_words import FreedomRow as FreedomRow
    from taut.analysis.constraints.specification import Specification as Specification
    from taut.analysis.constraints.specification import check_specification as check_specification
    from taut.analysis.constraints.specification import possible_specifications as possible_specifications
    from taut.analysis.constraints.task_freedoms import Freedoms as Freedoms
    from taut.analysis.constraints.task_freedoms import freedoms as freedoms
    from taut.analysis.design.design import Design as Design
    from taut.analysis.diagnosis.check import Check as Check
    from taut.analysis.diagnosis.check import Finding as Finding
    from taut.analysis.diagnosis.check import Threshold as Threshold
    from taut.analysis.diagnosis.checks import CHECKS as CHECKS
    from taut.analysis.diagnosis.diagnosis import Diagnosis as Diagnosis
    from taut.analysis.diagnosis.examined_run import ExaminedRun as ExaminedRun
    from taut.analysis.joint_coupling import Coupling as Coupling
    from taut.analysis.joint_coupling import coupling as coupling
    from taut.analysis.lyapunov_function import Lyapunov as Lyapunov
    from taut.analysis.lyapunov_function import lyapunov as lyapunov
    from taut.analysis.root_locus import Locus as Locus
    from taut.analysis.root_locus import locus as locus
    from taut.analysis.stability_regions import StabilityMap as StabilityMap
    from taut.analysis.stability_regions import stability_map as stability_map
    from taut.analysis.tool.environment import TipEnvironment as TipEnvironment
    from taut.analysis.tool.impedance import check_impedance as check_impedance
    from taut.analysis.tool.limits import StiffnessCheck as StiffnessCheck
    from taut.analysis.tool.limits import StiffnessLimits as StiffnessLimits
    from taut.analysis.tool.limits import check_stiffness as check_stiffness
    from taut.analysis.tool.limits import stiffness_limits as stiffness_limits
    from taut.analysis.tool.response import TipMeasurement as TipMeasurement
    from taut.analysis.tool.response import TipRanking as TipRanking
    from taut.analysis.tool.response import TipResponse as TipResponse
    from taut.analysis.tool.response import rank_tips as rank_tips
    from taut.analysis.tool.response import tip_impedance as tip_impedance
    from taut.analysis.tool.stiffness import check_stiffness_at as check_stiffness_at
    from taut.analysis.tool.stiffness import safe_stiffness as safe_stiffness
    from taut.analysis.tune.tune import Tick as Tick
    from taut.analysis.tune.tune import Trial as Trial
    from taut.analysis.tune.tune import Tuned as Tuned
    from taut.analysis.wrist_calibration import WristCalibration as WristCalibration
    from taut.analysis.wrist_calibration import calibrate_wrist as calibrate_wrist
    from taut.analysis.wrist_poses import calibration_poses as calibration_poses
    from taut.linear.error_dynamics import ErrorDynamics as ErrorDynamics
    from taut.linear.linear_loop import LinearLoop as LinearLoop
    from taut.linear.routh_table import RouthTable as RouthTable
    from taut.linear.routh_table import routh as routh
    from taut.linear.sampled import SampledLoop as SampledLoop
    from taut.linear.sampled_errors import SampledErrorDynamics as SampledErrorDynamics
    from taut.linear.second_order import second_order as second_order
    from taut.record.plots.friction_curves import plot_friction as plot_friction
    from taut.scenarios.compare import grade as grade

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
