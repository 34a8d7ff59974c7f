"""The random search over derivatives of the first three orders, in exact motion with events.

The first derivative is compared with differences of the compiled reference, each further one with differences of the
one before. Differences are taken at two distances: how far they disagree is the bound, and a share for round-off.
Where the sequence of events changes in between there is no derivative to compare.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import compiled
from support.search import numbers_of, stacked
from support.search_cases import drawn
from support.switched import Case

import stickslip_jax as ss

NUMBER, FAR = 60, 4e-4


def _moved(case_parts, theta):
    """The set-up with the friction, the stiffness and the start changed."""
    system, base, t1, y0 = case_parts
    system = ss.MassSpring(
        system.mass,
        system.stiffness * (1 + theta[1]),
        system.normal_force * (1 + theta[0]),
        system.friction,
        system.damping,
        system.force,
    )
    return system, base, t1, (y0[0] + theta[2], y0[1])


def _end(case_parts, theta):
    system, base, t1, y0 = _moved(case_parts, theta)
    one = ss.simulate(system, base, t1=t1, y0=y0, method=ss.Exact(max_steps=1024))
    lasting = jnp.where(one.sticks.mask, one.sticks.duration, 0)
    return jnp.stack([one.final_state[0], jnp.sum(lasting)]), (one.near_grazing_count, jnp.sum(one.sticks.mask))


def _derivative(order):
    def value(parts, theta):
        return _end(parts, theta)[0]

    function = value
    for _ in range(order):
        function = jax.jacfwd(function, argnums=1)
    return jax.jit(jax.vmap(function))


def _exact(case: Case, theta) -> tuple[np.ndarray, tuple]:
    """Position at the end and the stick time by the reference; the sequence of events."""
    numbers = numbers_of(case)
    found = compiled.run(
        numbers._replace(
            normal_force=numbers.normal_force * (1 + theta[0]),
            stiffness=numbers.stiffness * (1 + theta[1]),
            x=numbers.x + theta[2],
        )
    )
    lasting = float(np.sum(found.sticks[:, 1] - found.sticks[:, 0]))
    return np.array([found.state[0], lasting]), (found.crossings, *found.sticks[:, 3].tolist())


def differences(function, size: float) -> np.ndarray:
    """Central differences of ``function(theta)`` by each of three numbers, the last axis."""
    steps = size * np.eye(3)
    return np.stack([(function(step) - function(-step)) / (2 * size) for step in steps], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "orders"), [("harmonic", 3), ("steps", 2), ("record", 2)])
def test_orders(kind, orders):
    cases = [case._replace(t1=case.t1 / 3) for case in drawn(kind, "everyday", NUMBER)]
    kept = []
    for case in cases:
        sequences = {_exact(case, s * FAR * e)[1] for e in 2 * np.eye(3) for s in (-1, 0, 1)}
        if len(sequences) == 1 and sum(map(len, sequences)) > 1:
            kept.append(case)
    assert len(kept) > NUMBER / 3
    parts = stacked([(case.system, case.base.package, case.t1, case.y0) for case in kept])
    by_order = {order: _derivative(order) for order in range(1, orders + 1)}

    def evaluated(order, theta):
        return np.asarray(by_order[order](parts, np.tile(theta, (len(kept), 1))))

    def by_reference(theta):
        return np.stack([_exact(case, theta)[0] for case in kept])

    lower = [by_reference, partial(evaluated, 1), partial(evaluated, 2)]
    for order in range(1, orders + 1):
        found = evaluated(order, np.zeros(3))
        near, far = (differences(lower[order - 1], size) for size in (FAR / 4, FAR / 2))
        better = (4 * near - far) / 3
        axes = tuple(range(1, found.ndim))
        size = np.max(np.abs(better), axis=axes, keepdims=True)
        bound = 1e-6 * size + 3 * np.abs(near - far) + 1e-6
        wrong = [i for i in range(len(kept)) if not np.all(np.abs(found[i] - better[i]) <= bound[i])]
        assert not wrong, (order, len(wrong), len(kept))
