"""Conditions that end a phase of a task."""

from __future__ import annotations

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.control.tasks.guards import GuardView as GuardView
    from taut.control.tasks.guards import Lasting as Lasting
    from taut.control.tasks.guards import contact as contact
    from taut.control.tasks.guards import lasting as lasting
    from taut.control.tasks.guards import moved as moved
    from taut.control.tasks.guards import no_contact as no_contact
    from taut.control.tasks.guards import reached as reached
    from taut.control.tasks.guards import settled as settled

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
