"""Figures of simulations, of ensembles and of their statistics. Each function draws one and returns its axes.

All functions are called alike:

- The first argument is the result to draw: a `Simulation`, an `Ensemble`, or what was computed from one, such as a
  distribution. A curve or a map over parameters takes the values of the parameters first, then what was found there
  (`sensitivity_curve` only the latter, since a `Sensitivity` knows the value of its parameter).
- `ax` (one matplotlib Axes) or `axes` (several) says where to draw. It is the last argument, given by keyword. Without
  it, a new figure is made.
- The axes are returned: one, or a tuple of several. ``phase_portrait(one).figure.savefig("portrait.pdf")`` writes
  their figure to a file; so does `save`, which also closes it.
- Legends stand above the axes, so give titles to the figure (``figure.suptitle``), not to the axes.

`animate` makes a film, with a figure of its own, and returns an `Animation`. The `Look` of a system of your own says
what figures show of it, and its `Mechanism` how it moves in films.

Nothing is simulated here. Bad arguments raise ValueError with the name of the argument.
"""

from .._foundation.public_names import attached as _attached

__getattr__, __dir__, __all__ = _attached(__name__)
