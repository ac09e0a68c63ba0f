"""Functions for laws: NumPy's names, on floats and on symbols alike."""

from taut.trace.math import *  # noqa: F403
from taut.trace.math import __all__ as __all__
