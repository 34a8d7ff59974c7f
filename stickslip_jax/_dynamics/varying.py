"""Lanes whose system, excitation or start differ from sample to sample."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .. import _checks
from .._types import AnyArray, Array, BoolArray
from .lanes import Engine


class VaryingEngine(Engine):
    """An engine with numbers of its own for every sample.

    `template`: the engine of any sample. `places`: which of its leaves differ, in the order of ``jax.tree.leaves``.
    """

    template: Any
    places: tuple[int, ...] = eqx.field(static=True)

    @property
    def looks_back(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """That of the template."""
        return self.template.looks_back

    def of_sample(self, own: tuple[Array, ...]) -> Any:
        """The engine of the sample with its `own` leaves."""
        return with_leaves(self.template, self.places, own)

    def begin(self, key_data: Any, dtype) -> tuple[Any, Any]:
        raise NotImplementedError("the lanes call begin_own, because a sample is more than its key data")

    def begin_own(self, key_data: Any, own: tuple[Array, ...], dtype) -> tuple[Any, Any]:
        """As `begin`, for the sample with its `own` leaves; its constants are these, what its steps share, and its own
        constants.
        """
        engine = self.of_sample(own)
        sample, motion = engine.begin(key_data, dtype)
        return (own, engine.shared(dtype), sample), motion

    def shared(self, dtype) -> None:
        return None

    def draw(self, sample: Any, number: Array, dtype) -> Any:
        own, _, constants = sample
        return self.of_sample(own).draw(constants, number, dtype)

    def step(self, shared: None, sample: Any, motion: Any, drawn: Any) -> tuple[Any, Any]:
        own, shared_here, constants = sample
        return self.of_sample(own).step(shared_here, constants, motion, drawn)

    def ended(self, motion: Any, before: Any) -> BoolArray:
        return self.template.ended(motion, before)  # asks for the horizon only, which is the same for all samples

    def results(self, sample: Any, motion: Any) -> Any:
        own, _, constants = sample
        return self.of_sample(own).results(constants, motion)


def with_leaves(tree: Any, places: tuple[int, ...], values: Any) -> Any:
    """`tree` with the leaves at `places` replaced by `values`."""
    leaves, structure = jax.tree.flatten(tree)
    for place, value in zip(places, values, strict=True):
        leaves[place] = value
    return jax.tree.unflatten(structure, leaves)


def engines_of(build: Callable[[Any], Any], values: Any) -> tuple[Any, tuple[int, ...], tuple[AnyArray, ...]]:
    """The engines that `build` makes of each entry of `values`, a pytree of arrays (samples, ...).

    Returns one of them as a template (where they differ, with the leaves of the first), which leaves differ, and these,
    arrays (samples, ...). Sizes that depend on the values, such as numbers of steps, are the largest ones.
    """
    made = []

    def leaves_that_differ(values):
        engine = build(values)
        made.append(engine)
        return [leaf for leaf in jax.tree.leaves(engine) if _checks.is_traced(leaf)]

    own = jax.vmap(leaves_that_differ)(values)
    leaves, structure = jax.tree.flatten(made[0])
    places = tuple(place for place, leaf in enumerate(leaves) if _checks.is_traced(leaf))
    for place, column in zip(places, own, strict=True):
        leaves[place] = np.asarray(column[0])
    return jax.tree.unflatten(structure, leaves), places, tuple(own)


def widest(one: Any, other: Any, places: tuple[int, ...]) -> Any:
    """The template `one`, with sizes (whole numbers that all samples share) as large as in the template `other`."""
    leaves, structure = jax.tree.flatten(one)
    for place, leaf in enumerate(jax.tree.leaves(other)):
        if place not in places and isinstance(leaf, (int, np.integer)):
            leaves[place] = np.maximum(leaves[place], leaf)
    return jax.tree.unflatten(structure, leaves)
