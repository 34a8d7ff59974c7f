"""Stick-slip (dry-friction) oscillators under random motion: exact, vectorised, differentiable."""

from importlib import import_module

from . import _starting  # before all that takes time
from ._dynamics.simulate import simulate  # noqa: F401 - likewise
from ._ensemble.ensemble import simulate_ensemble  # noqa: F401 - loads all that a mass on a spring needs; the rest waits
from ._foundation.html import draw_with as _draw_with
from ._foundation.public_names import attached as _attached

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = _attached(__name__)

_draw_with(lambda result: import_module(f"{__name__}.plot._small").small_figure(result))
_starting.end()
