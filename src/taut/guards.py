"""Conditions that end a phase of a task."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.control.tasks.phase import GuardView as GuardView
    from taut.control.tasks.phase import Lasting as Lasting
    from taut.control.tasks.phase import collision as collision
    from taut.control.tasks.phase import contact as contact
    from taut.control.tasks.phase import energy as energy
    from taut.control.tasks.phase import lasting as lasting
    from taut.control.tasks.phase import moved as moved
    from taut.control.tasks.phase import no_contact as no_contact
    from taut.control.tasks.phase import reached as reached
    from taut.control.tasks.phase import settled as settled

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
