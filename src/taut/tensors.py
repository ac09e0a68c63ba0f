"""Tensors: batches of controllers on arrays of NumPy, torch, JAX or Warp, and a tick that torch differentiates."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.controller.batch import Batch as Batch
    from taut.controller.differentiable import Differentiable as Differentiable
    from taut.controller.differentiable import differentiable as differentiable

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
