"""Kinematics and dynamics of an arm as functions of floats or symbols."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.maths.constraints.multipliers import onto as onto
    from taut.maths.constraints.rows import ConstraintRows as ConstraintRows
    from taut.maths.dynamics import bias as bias
    from taut.maths.dynamics import coriolis_matrix as coriolis_matrix
    from taut.maths.dynamics import forward_dynamics as forward_dynamics
    from taut.maths.dynamics import gravity_torque as gravity_torque
    from taut.maths.dynamics import inverse_dynamics as inverse_dynamics
    from taut.maths.dynamics import jacobian as jacobian
    from taut.maths.dynamics import jacobian_rate_v as jacobian_rate_v
    from taut.maths.dynamics import kinetic_energy as kinetic_energy
    from taut.maths.dynamics import link_poses as link_poses
    from taut.maths.dynamics import mass_matrix as mass_matrix
    from taut.maths.dynamics import pose as pose
    from taut.maths.dynamics import potential_energy as potential_energy
    from taut.maths.dynamics import twist as twist
    from taut.maths.ik import IkOutcome as IkOutcome

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
