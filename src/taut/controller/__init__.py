"""The compiled control side: `compile` makes a `Controller` of a law, or a task, for one arm and one rate."""

from taut.controller.compile import compile
from taut.controller.controller import Controller
from taut.controller.parameters import take_up_change

__all__ = ["Controller", "compile", "take_up_change"]
