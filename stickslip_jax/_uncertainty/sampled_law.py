"""Laws that users write: any object with a method ``sample(key, t1)``."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .. import _checks
from .._types import Array

_NOT_TRACEABLE = (
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.ConcretizationTypeError,
)


@runtime_checkable
class UserLaw(Protocol):
    """A random base motion of your own: any object with this method. ::

    class Gusts:
        def sample(self, key, t1):
            times = jnp.linspace(0.0, t1, 201)
            steps = jax.random.normal(key, (201,))
            return ss.Recorded(times, 0.1 * jnp.cumsum(steps))
    """

    def sample(self, key: Array, t1: float) -> object:
        """One realisation that covers ``[0, t1]`` (s): a `Recorded` (joined by straight lines), a `PiecewiseConstant`
        or `VelocitySteps` (steps), or another base motion that `simulate` takes.

        All realisations must be of one class, with arrays of one length. The function may be JAX's or NumPy's; `key`
        is a key of JAX, from which NumPy takes ``numpy.random.default_rng(jax.random.key_data(key))``.
        """


class SampledLaw(eqx.Module):
    """A `UserLaw` as a law of the package.

    `law`: the object with the method ``sample(key, t1)``.
    """

    law: UserLaw = eqx.field(static=True)
    is_random = True

    def sample(self, key: Array, t1: float) -> PyTree:
        """The realisation that the user's law draws by `key`, for ``[0, t1]`` (s)."""
        return self.law.sample(key, t1)

    def realizations(self, keys: Callable[[], Array], t1: float, number: int) -> PyTree:
        """The realisations of all `keys` (`number` of them), their arrays stacked along a first axis.

        Raises ValueError for realisations of different classes or lengths.
        """
        try:
            return jax.vmap(lambda key: _each_as_array(self.law.sample(key, t1)))(keys())
        except _NOT_TRACEABLE:  # written in NumPy: one after the other
            each = keys()
            found = [_each_as_array(self.law.sample(each[i], t1)) for i in range(number)]
        shapes = {(jax.tree.structure(one), tuple(np.shape(leaf) for leaf in jax.tree.leaves(one))) for one in found}
        if len(shapes) > 1:
            raise ValueError(
                f"Argument law must give realisations of one class with arrays of one length, but sample of "
                f"{_checks.show(self.law)} gave {len(shapes)} kinds; fill up with equal values, or with unused "
                "intervals of VelocitySteps (duration 0)."
            )
        return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *found)


def _each_as_array(realization: PyTree) -> PyTree:
    """The realisation; its plain numbers are arrays of their own types, so that each sample can have its own."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, (int, float)) else leaf, realization)
