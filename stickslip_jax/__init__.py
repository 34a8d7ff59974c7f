"""Stick-slip (dry-friction) oscillators under random motion: exact, vectorised, differentiable."""

from ._status import Ending, Status
from .base_motion.laws import BangBangLaw, Constant, PiecewiseConstant, PoissonSwitching, RandomSteps, SquareWave
from .base_motion.piecewise import VelocitySteps
from .events import Slips, Sticks
from .simulate import Simulation, simulate
from .systems.friction import Coulomb
from .systems.mass_spring import MassSpring

__version__ = "0.1.0"
