"""A friction pendulum and a triple one under a ground motion, against OpenSees: five minutes.

``python docs/validation_bearings.py``, with openseespy 3.7.1.2 beside this package (``pip install openseespy``; on
Linux it needs libblas and liblapack). What this prints, and what it means, is in ``validation.md``.
"""

import jax
import numpy as np
import openseespy.opensees as ops

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

GRAVITY, MASS, RADIUS = 9.81, 2.0, 1.5
SLOW, FAST, RATE = 0.05, 0.10, 40.0  # -, -, s/m
STEP = 0.02  # s, of the record
FINER = ((8, 1e5), (32, 1e6), (128, 1e7), (512, 1e8))  # parts of each step of the record, stiffness before sliding, N/m
LENGTHS, COEFFICIENTS, WEIGHT = (0.36, 1.25, 1.25), (0.018, 0.075, 0.16), 1000.0  # of OpenSees' Example 5, by N. Dao


def record():
    """Times (s) and accelerations (m/s^2) of a ground motion."""
    times = STEP * np.arange(501)
    noise = np.convolve(np.random.default_rng(0).normal(size=501), np.ones(5) / 5, "same")
    return times, 3 * np.sin(2 * np.pi * times) * np.exp(-(((times - 4) / 2) ** 2)) + 0.5 * noise


def slid(bearing, times, accelerations):
    """Displacements at `times`, m, by this package, and the largest between them."""
    one = ss.simulate(bearing, ss.GroundAcceleration(times, accelerations), t1=float(times[-1]))
    return np.asarray(one.evaluate(times)[0]), float(one.peak("position 0"))


def by_opensees(times, accelerations, parts, stiffness, radius, element):
    """The same of one pendulum by OpenSees: average accelerations, `parts` steps for each of the record.

    `element`: "flatSliderBearing", with a linear spring W / R beside it, as here; or "singleFPBearing".
    """
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for node in (1, 2, 3):
        ops.node(node, 0.0, 0.0)
    ops.fix(1, 1, 1, 1)
    ops.fix(2, 0, 0, 1)
    ops.fix(3, 1, 1, 1)
    ops.mass(2, MASS, MASS, 0.0)
    ops.frictionModel("VelDependent", 1, SLOW, FAST, RATE)
    ops.uniaxialMaterial("Elastic", 1, 1e9)
    ops.uniaxialMaterial("Elastic", 2, 1e6)
    ops.uniaxialMaterial("Elastic", 3, MASS * GRAVITY / radius)
    upright = ("-P", 1, "-Mz", 2, "-orient", 0, 1, 0, -1, 0, 0, "-iter", 100, 1e-13)
    if element == "flatSliderBearing":
        ops.element(element, 1, 1, 2, 1, stiffness, *upright)
        ops.element("zeroLength", 2, 3, 2, "-mat", 3, "-dir", 1)
    else:
        ops.element(element, 1, 1, 2, 1, radius, stiffness, *upright)
    _pressed(MASS * GRAVITY, (0.0, -1.0, 0.0))
    return _shaken(times, accelerations, parts, 1e-13)


def triple_by_opensees(times, accelerations, parts, before):
    """The same of a triple pendulum; `before`: displacement before sliding, m."""
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    ops.node(1, 0.0, 0.0, 0.0)
    ops.node(2, 0.0, 0.0, 0.0)
    ops.fix(1, *(1,) * 6)
    ops.fix(2, 0, 1, 0, 1, 1, 1)
    mass = WEIGHT / GRAVITY
    ops.mass(2, mass, mass, mass, 1.0, 1.0, 1.0)
    for tag, coefficient in enumerate(COEFFICIENTS, start=1):
        ops.frictionModel("Coulomb", tag, coefficient)
    ops.uniaxialMaterial("Elastic", 1, 1e6)
    ops.uniaxialMaterial("Elastic", 2, 10.0)
    limits = (10.0, 10.0, 10.0)  # m: the rims are not reached
    more = (*LENGTHS, *limits, WEIGHT, before, 1.0, 0.1, 1e-8)
    ops.element("TripleFrictionPendulum", 1, 1, 2, 1, 2, 3, 1, 2, 2, 2, *more)
    _pressed(WEIGHT, (0.0, 0.0, -1.0, 0.0, 0.0, 0.0))
    return _shaken(times, accelerations, parts, 1e-8)


def _pressed(weight, down):
    ops.timeSeries("Linear", 1)
    ops.pattern("Plain", 1, 1)
    ops.load(2, *(weight * share for share in down))
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("BandGeneral")
    ops.test("NormDispIncr", 1e-14, 50, 0)
    ops.algorithm("Newton")
    ops.integrator("LoadControl", 0.1)
    ops.analysis("Static")
    assert ops.analyze(10) == 0
    ops.loadConst("-time", 0.0)
    ops.wipeAnalysis()


def _shaken(times, accelerations, parts, tolerance):
    ops.timeSeries("Path", 2, "-time", *map(float, times), "-values", *map(float, accelerations))
    ops.pattern("UniformExcitation", 2, 1, "-accel", 2)
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("BandGeneral")
    ops.test("NormDispIncr", tolerance, 100, 0)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    places = [0.0]
    for _ in range(parts * (len(times) - 1)):
        if ops.analyze(1, STEP / parts) != 0:
            raise RuntimeError("OpenSees found no equilibrium")
        places.append(ops.nodeDisp(2, 1))
    return np.array(places[::parts]), np.max(np.abs(places))


def row(name, found, known):
    (places, most), (ours, our_most) = found, known
    apart = 1e6 * np.max(np.abs(places - ours))
    print(f"| {name} | {1e3 * most:.4f} | {1e3 * places[-1]:.4f} | {apart:.1f} | {1e6 * (most - our_most):.1f} |")


def main():
    times, along = record()
    print("| | largest, mm | left, mm | apart at the points of the record, um | largest, less ours, um |")
    print("|---|---|---|---|---|")
    for radius in (RADIUS, 10 * RADIUS):
        friction = ss.VelocityDependent(SLOW, FAST, RATE)
        known = slid(ss.friction_pendulum(MASS, radius, friction, gravity=GRAVITY), times, along)
        row(f"R = {radius:g} m, here", known, known)
        for element in ("flatSliderBearing", "singleFPBearing"):
            for parts, stiffness in FINER if radius == RADIUS else FINER[-1:]:
                found = by_opensees(times, along, parts, stiffness, radius, element)
                row(f"{element}, {STEP / parts:.2g} s, {stiffness:.0e} N/m", found, known)
    first, second, third = LENGTHS
    radii, laws = [2 * first, second - first, third - first], [ss.Coulomb(mu) for mu in COEFFICIENTS]
    bearing = ss.friction_pendulum(WEIGHT / GRAVITY, radii, laws, gravity=GRAVITY)
    known = slid(bearing, times, along)
    row("triple, here", known, known)
    for parts, before in ((32, 1e-4), (128, 1e-5)):
        found = triple_by_opensees(times, along, parts, before)
        row(f"TripleFrictionPendulum, {STEP / parts:.2g} s, {before:.0e} m", found, known)


if __name__ == "__main__":
    main()
