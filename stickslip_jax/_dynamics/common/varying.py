"""Lanes whose system, excitation or start differ from sample to sample."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ... import _checks
from ..._types import AnyArray, Array, BoolArray
from .engine import Engine


class _Common(eqx.Module):
    """What the steps of the template share, and which of its leaves differ from sample to sample."""

    shared: Any
    leaf_numbers: tuple[int, ...] = eqx.field(static=True)


class VaryingEngine(Engine):
    """An engine with numbers of its own for every sample.

    `template`: the engine of any sample. `leaf_numbers`: which of its leaves vary, in the order of ``jax.tree.leaves``.
    """

    template: Any
    leaf_numbers: tuple[int, ...] = eqx.field(static=True)

    @property
    def looks_back(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """That of the template."""
        return self.template.looks_back

    @property
    def tracks(self) -> int | None:
        return self.template.tracks

    @property
    def compiles_natively(self) -> bool:
        return self.template.compiles_natively

    def asked(self, quantities: tuple[str, ...]) -> "VaryingEngine":
        return VaryingEngine(self.template.asked(quantities), self.leaf_numbers)

    def of_sample(self, varying: tuple[Array, ...]) -> Any:
        """The engine of the sample with its `varying` leaves."""
        return with_leaves(self.template, self.leaf_numbers, varying)

    def begin(self, key_data: Any, dtype) -> tuple[Any, Any]:
        leaves = jax.tree.leaves(self.template)
        return self.begin_varying(key_data, tuple(leaves[place] for place in self.leaf_numbers), dtype)

    def begin_varying(self, key_data: Any, varying: tuple[Array, ...], dtype) -> tuple[Any, Any]:
        """As `begin`, for the sample with its `varying` leaves.

        Its constants are these, what its steps share unlike those of other samples, and the template's constants.
        """
        engine = self.of_sample(varying)
        sample, motion = engine.begin(key_data, dtype)
        leaves = jax.tree.leaves(engine.shared(dtype))
        return (varying, tuple(leaves[place] for place in self._shared_leaf_numbers(dtype)), sample), motion

    def constants(self, sample: Any) -> Any:
        """The constants of samples as the template knows them."""
        return sample[2]

    def shared(self, dtype) -> _Common:
        return _Common(self.template.shared(dtype), self._shared_leaf_numbers(dtype))

    def _shared_leaf_numbers(self, dtype) -> tuple[int, ...]:
        """Which leaves of what the steps share follow from `varying` leaves.

        The others are not carried from lane to lane: a record of a base motion has thousands of points.
        """
        leaves = jax.tree.leaves(self.template)
        varying = tuple(jnp.asarray(leaves[place])[None] for place in self.leaf_numbers)

        def differs(place: int) -> bool:
            def leaf(varying):
                return jax.tree.leaves(self.of_sample(varying).shared(dtype))[place]

            try:
                jax.eval_shape(jax.vmap(leaf, out_axes=None), varying)
            except ValueError:  # the leaf is mapped
                return True
            return False

        return tuple(filter(differs, range(len(jax.tree.leaves(self.template.shared(dtype))))))

    def draw(self, sample: Any, number: Array, dtype) -> Any:
        varying, _, constants = sample
        return self.of_sample(varying).draw(constants, number, dtype)

    def step(self, shared: _Common, sample: Any, motion: Any, drawn: Any) -> tuple[Any, Any]:
        varying, mine, constants = sample
        here = with_leaves(shared.shared, shared.leaf_numbers, mine)
        return self.of_sample(varying).step(here, constants, motion, drawn)

    def ended(self, motion: Any, before: Any) -> BoolArray:
        return self.template.ended(motion, before)  # asks for the horizon only, which is the same for all samples

    def results(self, sample: Any, motion: Any) -> Any:
        varying, _, constants = sample
        return self.of_sample(varying).results(constants, motion)


def with_leaves(tree: Any, leaf_numbers: tuple[int, ...], values: Any) -> Any:
    """`tree` with the leaves at `leaf_numbers` replaced by `values`."""
    leaves, structure = jax.tree.flatten(tree)
    for place, value in zip(leaf_numbers, values, strict=True):
        leaves[place] = value
    return jax.tree.unflatten(structure, leaves)


class Engines(NamedTuple):
    """Engines of many samples.

    - `template`: one of them; where they differ, with the leaves of the first. Sizes, such as numbers of steps, are the
      largest that any sample needs.
    - `leaf_numbers`: which leaves vary; `varying`: these, arrays (samples, ...).
    - `origins`: for each place, which of the values it is; None where it follows from them.
    """

    template: Any
    leaf_numbers: tuple[int, ...]
    varying: tuple[AnyArray, ...]
    origins: tuple[int | None, ...]


def engines_of(build: Callable[..., Any], values: tuple[AnyArray, ...], others: Any = None) -> Engines:
    """The engines that `build` makes of each entry of `values` and `others`, arrays (samples, ...)."""
    made, origins = [], []

    def leaves_that_differ(values, others):
        engine = build(values, others)
        varying = [leaf for leaf in jax.tree.leaves(engine) if _checks.is_traced(leaf)]
        made.append(engine)
        origins.extend(next((i for i, value in enumerate(values) if value is leaf), None) for leaf in varying)
        return varying

    varying = jax.vmap(leaves_that_differ)(values, others)
    leaves, structure = jax.tree.flatten(made[0])
    leaf_numbers = tuple(place for place, leaf in enumerate(leaves) if _checks.is_traced(leaf))
    for place, column in zip(leaf_numbers, varying, strict=True):
        leaves[place] = column[0]
    return Engines(jax.tree.unflatten(structure, leaves), leaf_numbers, tuple(varying), tuple(origins))


def widest(templates: list[Any], leaf_numbers: tuple[int, ...]) -> Any:
    """The first template, with sizes (whole numbers that all samples share) as large as in any other."""
    leaves, structure = jax.tree.flatten(templates[0])
    for other in templates[1:]:
        for place, leaf in enumerate(jax.tree.leaves(other)):
            if place not in leaf_numbers and isinstance(leaf, (int, np.integer)):
                leaves[place] = np.maximum(leaves[place], leaf)
    return jax.tree.unflatten(structure, leaves)
