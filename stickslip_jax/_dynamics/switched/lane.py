"""The state of a trajectory between two steps of the switched engine, and what counts as round-off in it."""

from typing import NamedTuple

from ..._events.stick_quantities import Remembered
from ..._events.sticks import Totals
from ..._excitation.segments import SegmentState
from ..._systems.switched_model import State
from ..._types import BoolArray, FloatArray, IntArray

CLOCK_ULPS = 4  # the round-off of times, in units in the last place
NEAR_GRAZING = {8: 1e-9, 4: 1e-3}  # fraction of the guard's scale


class Lane(NamedTuple):
    """Loop state of one trajectory.

    Of each contact (scalars, or arrays): `sign`, that of the relative velocity, 0 in a stick, and `event`. What belongs
    to sticks is of each that can be `SwitchedModel.stuck`.
    """

    t: FloatArray
    y: State
    sign: FloatArray
    target: FloatArray  # length of the next step to try
    accurate_step: FloatArray  # the longest step that the errors of the steps so far allow
    event: FloatArray  # time of the last event at rest
    tries: IntArray
    steps: IntArray  # loop steps so far
    stick_start: FloatArray
    start_error: FloatArray  # by how much round-off may have moved it, s
    stick_position: FloatArray
    remembered: Remembered  # by the quantities of each stick that are asked for
    totals: Totals
    at_start: BoolArray
    near_grazing_count: IntArray
    segment_states: tuple[SegmentState, ...]
