"""Analyses of loops and runs: stiffness, constraints, design, diagnosis, comparison, tuning, identification."""

from __future__ import annotations

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.analysis.comparison import Comparison as Comparison
    from taut.analysis.comparison import WrongModel as WrongModel
    from taut.analysis.constraints import ConstraintRow as ConstraintRow
    from taut.analysis.constraints import ConstraintTable as ConstraintTable
    from taut.analysis.constraints import Specification as Specification
    from taut.analysis.constraints import check_specification as check_specification
    from taut.analysis.constraints import natural_constraints as natural_constraints
    from taut.analysis.design.achieved import Requirement as Requirement
    from taut.analysis.design.design import Design as Design
    from taut.analysis.diagnosis.check import Check as Check
    from taut.analysis.diagnosis.check import ExaminedRun as ExaminedRun
    from taut.analysis.diagnosis.check import Finding as Finding
    from taut.analysis.diagnosis.check import Threshold as Threshold
    from taut.analysis.diagnosis.checks import CHECKS as CHECKS
    from taut.analysis.diagnosis.diagnosis import Diagnosis as Diagnosis
    from taut.analysis.flexible_joints import SetPointCondition as SetPointCondition
    from taut.analysis.flexible_joints import set_point_condition as set_point_condition
    from taut.analysis.flexible_joints import stable_inversion as stable_inversion
    from taut.analysis.grading import Grade as Grade
    from taut.analysis.identification.excitation import excitation as excitation
    from taut.analysis.identification.identify import Estimate as Estimate
    from taut.analysis.identification.identify import Identification as Identification
    from taut.analysis.identification.identify import Verdict as Verdict
    from taut.analysis.identification.identify import identify as identify
    from taut.analysis.identification.payload import PayloadEstimate as PayloadEstimate
    from taut.analysis.identification.payload import payload_estimate as payload_estimate
    from taut.analysis.impedance_at_tool import ToolImpedance as ToolImpedance
    from taut.analysis.impedance_at_tool import tool_impedance as tool_impedance
    from taut.analysis.learning import Convergence as Convergence
    from taut.analysis.learning import Learning as Learning
    from taut.analysis.learning import LearningLaw as LearningLaw
    from taut.analysis.learning import NormOptimal as NormOptimal
    from taut.analysis.learning import PDLearning as PDLearning
    from taut.analysis.learning import learn as learn
    from taut.analysis.regulator import Lqr as Lqr
    from taut.analysis.regulator import lqr as lqr
    from taut.analysis.robustness import Certificate as Certificate
    from taut.analysis.robustness import boundary_layer as boundary_layer
    from taut.analysis.robustness import certify as certify
    from taut.analysis.several_joints import Coupling as Coupling
    from taut.analysis.several_joints import Lyapunov as Lyapunov
    from taut.analysis.several_joints import coupling as coupling
    from taut.analysis.several_joints import lyapunov as lyapunov
    from taut.analysis.stability.attraction import Attraction as Attraction
    from taut.analysis.stability.attraction import region_of_attraction as region_of_attraction
    from taut.analysis.stability.harmonic_balance import LimitCycle as LimitCycle
    from taut.analysis.stability.harmonic_balance import LimitCycles as LimitCycles
    from taut.analysis.stability.harmonic_balance import limit_cycles as limit_cycles
    from taut.analysis.stability.loci import RootLocus as RootLocus
    from taut.analysis.stability.loci import RouthTable as RouthTable
    from taut.analysis.stability.loci import StabilityMap as StabilityMap
    from taut.analysis.stability.loci import root_locus as root_locus
    from taut.analysis.stability.loci import routh as routh
    from taut.analysis.stability.loci import stability_map as stability_map
    from taut.analysis.stiffness import StiffnessCheck as StiffnessCheck
    from taut.analysis.stiffness import check_stiffness as check_stiffness
    from taut.analysis.stiffness import check_virtual_wall as check_virtual_wall
    from taut.analysis.sweeps.answers import Bands as Bands
    from taut.analysis.sweeps.answers import Rate as Rate
    from taut.analysis.sweeps.answers import Share as Share
    from taut.analysis.sweeps.sweep import Sweep as Sweep
    from taut.analysis.tuning import Trial as Trial
    from taut.analysis.tuning import Tuned as Tuned
    from taut.analysis.wrist_calibration import WristCalibration as WristCalibration
    from taut.analysis.wrist_calibration import calibrate_wrist as calibrate_wrist
    from taut.base.result import Content as Content
    from taut.base.result import Result as Result
    from taut.base.result import Table as Table
    from taut.linear.joint_loop import SecondOrder as SecondOrder
    from taut.linear.joint_loop import second_order as second_order
    from taut.linear.judgement import Judgement as Judgement
    from taut.linear.judgement import judge as judge
    from taut.linear.linear_system import OperatingPoint as OperatingPoint
    from taut.record.metrics import METRICS as METRICS
    from taut.record.metrics import Metric as Metric
    from taut.record.metrics.collision import collision_threshold as collision_threshold
    from taut.runtime.realtime.replay import Replay as Replay
    from taut.runtime.realtime.replay import replay as replay
    from taut.scenarios.compare import grade as grade

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
