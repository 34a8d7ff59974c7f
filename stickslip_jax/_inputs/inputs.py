"""The inputs of an ensemble: numbers of its system, law and start that differ from sample to sample."""

import dataclasses
import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._distributions.random_number import RandomNumber
from .._fields import Checked, Quantity, described, is_distribution, varies
from .._numerics.random_bits import key_data_of, random_words, uniform
from .._types import AnyArray, Array
from .numbers import Path, number_at, shown, with_numbers

_FIRST_STATE, _FIRST_NAMED = 0xFFFFFE00, 1 << 31
"""Numbers of the random words that initial values and other inputs are drawn from; laws draw from those below."""
_AT_ONCE = 1 << 16  # samples whose inputs are drawn together


class Input(NamedTuple):
    """One number that differs from sample to sample: where it stands, and its distribution or array of values."""

    path: Path
    source: Any
    about: Quantity | None

    @property
    def name(self) -> str:
        """Its full name, such as "system.friction.mu"."""
        return shown(self.path)

    @property
    def is_random(self) -> bool:
        """Whether it is drawn."""
        return is_distribution(self.source)

    @property
    def stream(self) -> int:
        """Number of the random word that it is drawn from: its own, so that other inputs change nothing."""
        if self.path[0] == "y0":
            return _FIRST_STATE + int(self.path[1])
        return _FIRST_NAMED + zlib.crc32(self.name.encode()) % (_FIRST_STATE - _FIRST_NAMED)


class Model(NamedTuple):
    """A system, the law of its excitation, and its initial state."""

    system: Any
    law: Any
    y0: Any


@dataclasses.dataclass(frozen=True, eq=False)
class Inputs:
    """All inputs of an ensemble, and how they are drawn.

    `model`: with the distributions and arrays in it. `names`: the short names of the inputs.
    """

    model: Model
    entries: tuple[Input, ...]
    names: tuple[str, ...]
    samples: int
    key_data: Any = None

    @classmethod
    def of(cls, model: Model, samples: int, key: Array | None) -> "Inputs":
        """The inputs in `model`. Raises ValueError for arrays of another length than `samples`, or a missing key."""
        y0 = _columns(model.y0)
        model = model._replace(y0=tuple(y0) if isinstance(y0, (tuple, list)) else y0)
        entries = tuple(Input(path, *found) for path, *found in varying(model))
        for entry in entries:
            if not entry.is_random and len(entry.source) != samples:
                raise ValueError(
                    f"Argument {shown(entry.path)} must hold one number for each of the {samples} samples, but an "
                    f"array of {len(entry.source)} was given."
                )
        if key is None and any(entry.is_random for entry in entries):
            raise ValueError(
                "Argument key must be a key such as jax.random.key(0) where law, system or y0 are random, but None "
                "was given."
            )
        streams = [entry.stream for entry in entries]
        assert len(set(streams)) == len(streams), "two names share a random word"
        return cls(model, entries, _short([entry.path for entry in entries]), samples,
                   None if key is None else key_data_of(key))  # fmt: skip

    @property
    def are_random(self) -> bool:
        """Whether an input is drawn."""
        return any(entry.is_random for entry in self.entries)

    @property
    def in_start(self) -> bool:
        """Whether the initial state holds an input."""
        return any(entry.path[0] == "y0" for entry in self.entries)

    def drawn(self, first: int, number: int, dtype: Any) -> tuple[AnyArray, ...]:
        """The values of every input for samples ``first .. first + number - 1``, arrays (number,).

        Beyond the last sample, arrays repeat their last value.
        """
        random = [entry for entry in self.entries if entry.is_random]
        uniforms = iter(self._uniforms(random, first, number, dtype))
        samples = np.minimum(np.arange(first, first + number), self.samples - 1)

        def values(entry):
            if not entry.is_random:
                return np.asarray(entry.source, dtype)[samples]
            return _quantiles(entry, next(uniforms), lambda: self._keys(entry, first, number))

        return tuple(values(entry) for entry in self.entries)

    def with_start(self, y0: tuple[Any, ...]) -> "Inputs":
        """The same inputs; where none of them is an initial value, with the checked initial state `y0`."""
        return self if self.in_start else dataclasses.replace(self, model=self.model._replace(y0=y0))

    def uniforms(self, first: int, number: int, dtype: Any) -> tuple[Any, ...]:
        """The uniform numbers that `drawn` draws from, (number,) each; None for arrays."""
        found = iter(self._uniforms([entry for entry in self.entries if entry.is_random], first, number, dtype))
        return tuple(next(found) if entry.is_random else None for entry in self.entries)

    def head(self, samples: int) -> Model:
        """The model of the first `samples` samples."""
        heads = [entry.source if entry.is_random else entry.source[:samples] for entry in self.entries]
        return self.filled(heads)

    def filled(self, values: Any) -> Model:
        """The model with one value for each input."""
        paths = tuple(entry.path for entry in self.entries)
        return with_numbers(self.model, paths, values) if paths else self.model

    def of_sample(self, number: int, dtype: Any) -> Model:
        """The model of sample `number`, with plain numbers."""
        return self.filled([float(value[0]) for value in self.drawn(number, 1, dtype)])

    def values(self, dtype: Any) -> dict[str, np.ndarray]:
        """The values of all samples by the inputs' short names, arrays (samples,)."""
        parts = [self.drawn(first, _AT_ONCE, dtype) for first in range(0, self.samples, _AT_ONCE)]
        columns = [np.concatenate([np.asarray(part[i]) for part in parts]) for i in range(len(self.entries))]
        return {name: column[: self.samples] for name, column in zip(self.names, columns, strict=True)}

    def check(self, dtype: Any) -> None:
        """Check all values against the bounds of their fields. Raises ValueError that says how many are outside."""
        for first in range(0, self.samples, _AT_ONCE):
            number = min(_AT_ONCE, self.samples - first)
            drawn = [np.asarray(column)[:number] for column in self.drawn(first, _AT_ONCE, dtype)]
            for entry, name, values in zip(self.entries, self.names, drawn, strict=True):
                self._check_values(entry, name, values, first)
            self._check_relations(drawn, first)

    def _check_values(self, entry: Input, name: str, values: np.ndarray, first: int) -> None:
        wrong = (entry.about or Quantity()).outside(values)
        if not np.any(wrong):
            return
        at = int(np.argmax(wrong))
        if not entry.is_random:  # the constructor has seen arrays of fields with bounds
            raise ValueError(f"Argument {name}[{first + at}] must be finite, but {values[at]} was given.")
        try:
            (entry.about or Quantity()).check(name, float(values[at]))
        except ValueError as error:
            raise ValueError(
                f"Argument {name} must be a distribution within the bounds of {name}, but {np.count_nonzero(wrong)} of "
                f"the draws {first} to {first + len(values) - 1} are outside, first that of sample {first + at}; "
                f"restrict it with Truncated(..., low=..., high=...). {error}"
            ) from error

    def _check_relations(self, drawn: list[np.ndarray], first: int) -> None:
        """What several numbers of a module must satisfy together, sample by sample where they vary."""
        filled, paths = self.filled(drawn), [entry.path for entry in self.entries]
        for depth in {path[:end] for path in paths for end in range(1, len(path))}:
            module = number_at(filled, depth)
            if not isinstance(module, Checked) or type(module).check_relations is Checked.check_relations:
                continue
            try:
                type(module).check_relations(module)  # made for single numbers, but comparisons may hold for arrays
            except (ValueError, TypeError):
                inside = [(path[len(depth):], values) for path, values in zip(paths, drawn, strict=True)
                          if path[: len(depth)] == depth]  # fmt: skip
                for sample in range(len(drawn[0])):
                    one = with_numbers(module, tuple(path for path, _ in inside),
                                       [float(values[sample]) for _, values in inside])  # fmt: skip
                    try:
                        type(one).check_relations(one)
                    except ValueError as error:
                        raise ValueError(f"Sample {first + sample} does not fit: {error}") from error

    def _uniforms(self, random: list[Input], first: int, number: int, dtype: Any) -> Array:
        if not random:
            return jnp.zeros((0, number))
        streams = np.array([entry.stream for entry in random], np.uint32)
        return _uniforms(self.key_data, np.uint32(first), streams, number=number, dtype=dtype)

    def _keys(self, entry: Input, first: int, number: int) -> Array:
        """A key of `entry` for each sample."""
        samples = np.arange(first, first + number, dtype=np.uint32)
        own = random_words(random_words(self.key_data, jnp.asarray(samples)), jnp.uint32(entry.stream))
        return jax.random.wrap_key_data(jnp.stack(own, axis=-1))


@jax.jit
def _of_distribution(distribution: RandomNumber, u: Array) -> Array:
    return jnp.asarray(distribution.icdf(u), u.dtype)


def _uniforms_of(key_data: Any, first: Any, streams: Any, *, number: int, dtype: Any) -> Array:
    """Uniform numbers (streams, number) of samples ``first, first + 1, ...``."""
    own = random_words(key_data, first + jnp.arange(number, dtype=jnp.uint32))
    return jax.vmap(lambda stream: uniform(random_words(own, stream)[0], dtype))(streams)


_uniforms = jax.jit(_uniforms_of, static_argnames=("number", "dtype"))


def _quantiles(entry: Input, u: Array, keys: Any) -> AnyArray:
    """The values of `entry` at the uniform numbers `u`; of a distribution that only samples, by keys of its own."""
    source = entry.source
    if isinstance(source, RandomNumber):
        return _of_distribution(source, u)
    for name, argument in (("ppf", np.asarray(u)), ("icdf", u)):
        if callable(getattr(source, name, None)):
            try:
                values = np.asarray(getattr(source, name)(argument), u.dtype)
            except NotImplementedError:
                continue
            if values.shape == u.shape:
                return values
            raise ValueError(
                f"Argument {entry.name} must be a distribution of one number, but {name} of {_checks.show(source)} "
                f"gave an array of shape {values.shape} for {len(u)} samples."
            )
    return np.asarray(jax.vmap(source.sample)(keys()), u.dtype)


def _columns(y0: Any) -> Any:
    """`y0` with a column for each coordinate, where it is an array (samples, coordinates)."""
    if not isinstance(y0, (tuple, list)) and not is_distribution(y0) and np.ndim(y0) == 2:
        return tuple(np.asarray(y0).T)
    return y0


def varying(tree: Any, path: Path = (), about: Any = None) -> Iterator[tuple[Path, Any, Quantity | None]]:
    """Path, distribution or array, and field of every input in `tree`."""
    if isinstance(tree, RandomNumber) or (about is not None and varies(tree, about)):
        yield path, tree, about
    elif isinstance(tree, eqx.Module):
        abouts = described(type(tree))
        for field in dataclasses.fields(tree):
            if not field.metadata.get("static", False):
                yield from varying(getattr(tree, field.name), (*path, field.name), abouts.get(field.name))
    elif isinstance(tree, Model):
        for name, part in tree._asdict().items():
            yield from varying(part, (name,))
    elif isinstance(tree, (tuple, list)):
        for index, value in enumerate(tree):
            yield from varying(value, (*path, index), Quantity() if path == ("y0",) else None)
    elif any(callable(getattr(tree, name, None)) for name in ("icdf", "ppf")):
        yield path, tree, None


def _short(paths: list[Path]) -> tuple[str, ...]:
    """The shortest endings of the paths that no other path has."""
    names = []
    for path in paths:
        if path[0] == "y0":
            names.append(shown(path))
            continue
        sizes = range(1, len(path) + 1)
        size = next(size for size in sizes if sum(other[-size:] == path[-size:] for other in paths) == 1)
        names.append(shown(path[-size:]))
    return tuple(names)
