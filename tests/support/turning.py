"""A disc that turns evenly, known in closed form: its angle comes back after every whole turn."""

import math

import stickslip_jax as ss

DRAG = 2.0
FAR = ss.Constant(50.0)
"""A base that the disc never keeps up with."""


class Disc(ss.SwitchedSystem):
    """A disc that a torque turns against a drag: after a while at the rate ``torque / DRAG``, in rad/s."""

    torque: float = 3.0

    @property
    def state_names(self):
        return ("angle in rad", "angular velocity in rad/s")

    @property
    def coordinates(self):
        angle, rate = super().coordinates
        return angle._replace(period=2 * math.pi), rate

    def rates(self, t, y, base, friction):
        return y[1], self.torque - DRAG * y[1]

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return 3.0
