"""Nonlinear dynamics with sticks: sections, bifurcation diagrams, basins, periodic orbits, Lyapunov exponents."""

from .._foundation.public_names import attached as _attached

__getattr__, __dir__, __all__ = _attached(__name__)
