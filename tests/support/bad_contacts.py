"""Calls of what has several contacts, and of what is followed from period to period, for `support.bad_calls`."""

from collections.abc import Iterator
from functools import partial

import jax
import numpy as np

import stickslip_jax as ss
from stickslip_jax import nonlinear
from support.bad_values import Target, fields

FRICTION = ss.Coulomb(0.3)
DISK = ss.FrictionDisk(1.0, FRICTION)
ROW = ss.block_row(2, mass=1.0, between=1.0, to_ground=1.0, normal_force=1.0, friction=FRICTION)


def structures() -> Iterator[Target]:
    """Builders of structures, and simulations of one."""
    normal, law = (1.0, "positive field | force"), (FRICTION, "friction")
    rows = {"stiffness": (np.array([3.0]), "optional array"), "damping": (np.array([0.1]), "optional array")}
    yield fields(
        ss.LinearStructure, ("direction",), mass=(np.eye(2), "reals"), stiffness=(np.eye(2), "reals"),
        damping=(0.1 * np.eye(2), "optional reals"), contacts=(ROW.contacts, "never"), force=(None, "optional any"),
        uncoupled=(None, "optional truth"), rotates=(False, "truth"), drawn_as=("bars", "optional never"),
        counted_contact=(None, "optional whole or zero"),
    )  # fmt: skip
    yield fields(
        lambda direction: ss.LinearStructure(np.eye(2), np.eye(2), None, (ss.Contact(direction, 1.0, FRICTION),)),
        direction=([1.0, 0.0], "array"),
    )
    yield fields(
        ss.Contact, direction=([1.0, 0.0], "array"), normal_force=normal, friction=law, on_base=(1.0, "field"),
        radius=(1.0, "positive field"),
    )  # fmt: skip
    yield fields(
        ss.FrictionDisk, normal_force=normal, friction=law, radius=(1.0, "positive field"),
    )  # fmt: skip
    yield fields(
        ss.drivetrain, inertia=([1.0, 2.0], "array"), **rows, drag=(None, "optional array"),
        clutches=((DISK,), "optional never"), brakes=((None, DISK), "optional never"), torque=(None, "optional any"),
    )  # fmt: skip
    yield fields(
        ss.drill_string, ("normal_force",), inertia=([1.0, 2.0], "array"), stiffness=([3.0], "array"),
        weight_on_bit=normal, bit_radius=(0.1, "positive"), friction=law, damping=(None, "optional array"),
        drag=(None, "optional array"), torque=(1.0, "never | number | signal"), drive_torque=(None, "optional number"),
    )  # fmt: skip
    yield fields(
        ss.storeys_on_bearing, mass=([2.0, 1.0], "array"), stiffness=([3.0], "array"), friction=law,
        damping=(None, "optional array"), bearing_stiffness=(0.0, "not negative"), gravity=(9.81, "positive"),
    )  # fmt: skip
    yield fields(
        ss.friction_pendulum, mass=(1.0, "positive"), radius=(1.0, "positive field"), friction=law,
        gravity=(9.81, "positive"),
    )  # fmt: skip
    yield fields(
        ss.pendulum_in_series, weight=(1.0, "positive"), radii=([1.0, 2.0], "array"),
        coefficients=([0.1, 0.2], "array"), direction=([1.0], "array"),
    )  # fmt: skip
    yield fields(
        ss.block_row, blocks=(2, "whole"), mass=(1.0, "positive"), between=(1.0, "not negative"),
        to_ground=(1.0, "not negative"), normal_force=normal, friction=law, damping=(0.0, "not negative"),
    )  # fmt: skip
    block = {
        "mass": (1.0, "positive"), "gravity": (9.81, "positive"), "friction": (None, "optional never"),
        "yield_coefficient": (0.1, "positive field"), "uphill": (None, "optional positive field"),
    }  # fmt: skip
    column = {"period": (0.5, "positive"), "damping_ratio": (0.1, "not negative"), "modes": (1, "whole")}
    yield fields(ss.rigid_block, **block)
    yield fields(ss.coupled_block, **block, **column)
    yield fields(ss.rigid_block, friction=law, slope=(0.1, "not negative"))
    record = ss.GroundAcceleration([0.0, 1.0], [1.0, 1.0])
    yield fields(ss.equivalent_acceleration, record=(record, "never"), **column, parts=(1, "whole"))
    yield fields(
        ss.newmark_displacements, records=([record], "never"),
        yield_coefficients=(0.1, "any"), scales=(1.0, "any"),
        block=(ss.rigid_block, "function"), rest=(1.0, "not negative"),
    )  # fmt: skip
    yield fields(
        partial(ss.simulate_contacts, ROW, ss.Constant(0.1)), t1=(1.0, "positive"), samples=(2, "whole | design"),
        key=(jax.random.key(0), "optional key"), y0=(None, "optional start"),
        first_sample=(0, "whole or zero"), orders=(3, "whole"), count_initial_rest=(False, "truth"),
        threads=(1, "optional whole"), progress=(False, "optional truth"),
    )  # fmt: skip


def periods() -> Iterator[Target]:
    """Sections, diagrams, basins, exponents and orbits."""
    system, base = ss.MassSpring(1.0, 4.0, 1.0, FRICTION), ss.Harmonic(1.0, 1.4)
    driven = {
        "system": (system, "system"), "base": (base, "base"), "transient": (1, "whole or zero"), "kept": (2, "whole"),
        "period": (None, "optional positive"), "method": (ss.Exact(), "method"), "progress": (False, "optional truth"),
        "folder": (None, "optional path"),
    }  # fmt: skip
    begun = {**driven, "y0": ((0.0, 1.0), "optional start | reals")}
    over = {"over": (None, "optional never")}
    yield fields(nonlinear.stroboscopic_section, ("base", "mu"), **begun, **over, tolerance=(1e-6, "positive"))
    yield fields(nonlinear.event_section, **begun, **over, of=("stick_start", "never"), contact=(0, "whole or zero"))
    yield fields(
        lambda values: nonlinear.bifurcation_diagram(system, base, {"mu": values}, transient=1, kept=2, progress=False),
        ("over", "mu"), values=([0.2, 0.3], "array"),
    )  # fmt: skip
    yield fields(
        nonlinear.basins, **{**driven, "y0": ([[0.0, 1.0], [0.1, 0.0]], "reals | mapping")}, most=(4, "whole"),
        tolerance=(1e-3, "positive"), level=(0.9, "positive"),
    )  # fmt: skip
    yield fields(nonlinear.lyapunov_exponents, **begun, **over, exponents=(1, "optional whole"))
    yield fields(
        nonlinear.periodic_orbit, **{name: driven[name] for name in ("system", "base", "period", "method")},
        y0=((0.0, 1.0), "optional start"), periods=(1, "whole"), tolerance=(None, "optional positive"),
        iterations=(2, "whole"),
    )  # fmt: skip
