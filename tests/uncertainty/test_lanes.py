"""What lanes carry where samples differ."""

import jax
import jax.numpy as jnp
import numpy as np

import stickslip_jax as ss
from stickslip_jax._dynamics.common.lanes import Job, VaryingEngine, engines_of, lanes_at_start
from stickslip_jax._dynamics.common.method import Arguments, Exact
from stickslip_jax._dynamics.engine_choice import engine_for

TIMES = np.linspace(0, 100, 1001)
RECORD = ss.Recorded(TIMES, np.cos(TIMES))


def test_a_record_that_all_samples_share_is_not_carried_from_lane_to_lane():
    """Copies of it in 256 lanes made ensembles with random starts four times as slow."""

    def build(*values):
        (mu, position), _ = values
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        return engine_for(Arguments(system, RECORD, Exact(step=0.1), 10.0)).lanes((position, 0.0), jnp.float64)

    engines = engines_of(build, (jnp.array([0.5, 0.6]), jnp.array([0.0, 0.1])))
    job = Job(VaryingEngine(engines.template, engines.leaf_numbers), jnp.zeros(2, jnp.uint32), 0, 1, engines.varying)
    carried = jax.eval_shape(lambda: lanes_at_start(job, 2, jnp.float64))
    largest = max(leaf.size // 2 for leaf in jax.tree.leaves(carried))
    assert largest < 10
