"""The inputs of an ensemble: numbers of its system, law and start that differ from sample to sample, and how they
are correlated.
"""

import dataclasses
import zlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, PyTree

from .._compiler.programs import kept_jit
from .._foundation import checks
from .._foundation.fields import Checked, Module, Quantity, described, is_distribution, varies
from .._foundation.types import AnyArray, DType, FloatArray, Number
from .._numerics.elementary import key_data_of, random_words, uniform
from .design import Design
from .families import RandomNumber
from .numbers import NumberPath, check_realizations, matching, number_at, numbers_in, shown, with_numbers

# Correlated random numbers: a Gaussian copula.


_ROUND_OFF = 1e-6
"""How far from symmetric, or from 1 on the diagonal, a matrix may be: correlations that were stored in float32."""


def _as_names(names: object) -> tuple[str, ...]:
    found = tuple(names) if isinstance(names, Sequence) and not isinstance(names, (str, bytes, range)) else ()
    if len(found) < 2 or not all(isinstance(name, str) and name for name in found) or len(set(found)) < len(found):
        demand = "hold two or more different names of random numbers, such as ('mu', 'stiffness')"
        raise checks.refused("names", demand, names)
    return found


def _as_matrix(name: str, matrix: Any) -> AnyArray:
    if checks.is_traced(matrix):
        return matrix
    checks.numeric(name, matrix, ndim=2)
    return np.asarray(matrix, np.float64)


class GaussianCopula(Module):
    """Random numbers that depend on each other: each has its own distribution, their normal scores are correlated.

    The normal score of a number x with distribution function F is ``z = ndtri(F(x))``; the scores are jointly normal
    (Nataf 1962).

    - `names`: of the numbers that are correlated, at least two, such as ``("mu", "stiffness")``.
    - `correlation`: (names, names), Pearson's correlations of their normal scores, in the order of `names`. Of numbers
      that are not normally distributed, Pearson's correlations are a little smaller in size; for rank correlations take
      `from_spearman`.

    Raises ValueError for names that are not distinct, and for a matrix that is not symmetric, has not 1 on its
    diagonal, or is not positive definite.
    """

    names: tuple[str, ...] = eqx.field(converter=_as_names, static=True)
    correlation: AnyArray = eqx.field(converter=lambda matrix: _as_matrix("correlation", matrix))

    def __check_init__(self):
        _check_correlation("correlation", self.correlation, len(self.names))

    @classmethod
    def from_spearman(cls, names: Sequence[str], matrix: npt.ArrayLike) -> "GaussianCopula":
        """The copula whose numbers have these rank correlations, whatever their distributions.

        - `matrix`: (names, names), Spearman's correlations rho; those of the normal scores are ``2 sin(pi rho / 6)``
          (Pearson 1907).

        Raises ValueError for what the constructor refuses, and for rank correlations that no Gaussian copula has.
        """
        names, matrix = _as_names(names), _as_matrix("matrix", matrix)
        _check_correlation("matrix", matrix, len(names))
        module = jnp if checks.is_traced(matrix) else np
        scores = 2 * module.sin(module.pi / 6 * module.asarray(matrix))
        if not checks.is_traced(scores):
            _check_definite("matrix", scores, "normal scores with these rank correlations", "2 sin(pi rho / 6)")
        return cls(names, scores)

    def correlated(self, u: FloatArray) -> FloatArray:
        """Uniform numbers with this dependence, made of independent ones.

        - `u`: (..., names), in (0, 1), in the order of `names`.

        Returns an array of the same shape and precision, in (0, 1). The first number stays as it is but for round-off,
        the others move; all change smoothly with `u` and with the correlations. Raises ValueError for another last
        dimension.
        """
        if jnp.ndim(u) == 0 or jnp.shape(u)[-1] != len(self.names):
            raise ValueError(
                f"Argument u must have a last dimension of {len(self.names)}, one number for each of "
                f"{', '.join(self.names)}, but an array of shape {jnp.shape(u)} was given."
            )
        z = ndtri(jnp.asarray(u, jnp.result_type(u, jnp.float32)))
        module = jnp if checks.is_traced(self.correlation) else np
        root = jnp.asarray(module.linalg.cholesky(self.correlation), z.dtype)[(None,) * (z.ndim - 1)]
        # One term after the other: a product of matrices may round differently for other numbers of samples.
        scores = sum(root[..., index] * z[..., index, None] for index in range(len(self.names)))
        limits = jnp.finfo(z.dtype)
        return jnp.clip(ndtr(scores), limits.tiny, 1 - limits.epsneg)


def _check_correlation(name: str, matrix: AnyArray, number: int) -> None:
    if np.shape(matrix) != (number, number):
        raise ValueError(
            f"Argument {name} must have shape ({number}, {number}), a row and a column for each of the names, but an "
            f"array of shape {np.shape(matrix)} was given."
        )
    if checks.is_traced(matrix):
        return
    uneven = np.argwhere(np.abs(matrix - matrix.T) > _ROUND_OFF)
    if len(uneven):
        i, j = (int(part) for part in uneven[0])
        raise ValueError(
            f"Argument {name} must be symmetric, but {name}[{i}, {j}] = {matrix[i, j]} and {name}[{j}, {i}] = "
            f"{matrix[j, i]} were given."
        )
    wrong = np.abs(np.diag(matrix) - 1) > _ROUND_OFF
    if wrong.any():
        i = int(np.argmax(wrong))
        raise ValueError(
            f"Argument {name} must have 1 on its diagonal, but {name}[{i}, {i}] = {matrix[i, i]} was given; divide "
            "covariances by both standard deviations."
        )
    _check_definite(name, matrix, "random numbers", "it")


def _check_definite(name: str, matrix: AnyArray, of: str, what: str) -> None:
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if not smallest > _ROUND_OFF:
        raise ValueError(
            f"Argument {name} must be positive definite, or no {of} exist, but the smallest eigenvalue of {what} is "
            f"{smallest:.3g}; make correlations smaller, or leave out a number that others determine."
        )


# Laws that users write: any object with a method ``sample(key, t1)``.


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
        except checks.NOT_TRACEABLE:  # written in NumPy: one after the other
            each = keys()
            found = [_each_as_array(self.law.sample(each[i], t1)) for i in range(number)]
        shapes = {(jax.tree.structure(one), tuple(np.shape(leaf) for leaf in jax.tree.leaves(one))) for one in found}
        if len(shapes) > 1:
            raise ValueError(
                f"Argument law must give realisations of one class with arrays of one length, but sample of "
                f"{checks.show(self.law)} gave {len(shapes)} kinds; fill up with equal values, or with unused "
                "intervals of VelocitySteps (duration 0)."
            )
        return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *found)


def _each_as_array(realization: PyTree) -> PyTree:
    """The realisation; its plain numbers are arrays of their own types, so that each sample can have its own."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, (int, float)) else leaf, realization)


# The inputs of an ensemble: numbers of its system, law and start that differ from sample to sample.


_FIRST_STATE, _FIRST_NAMED = 0xFFFFFE00, 1 << 31
"""Numbers of the random words that initial values and other inputs are drawn from; laws draw from those below."""
_STATES_ABOVE = (1 << 32) - _FIRST_STATE  # 512
_AT_ONCE = 1 << 16  # samples whose inputs are drawn together


class Input(NamedTuple):
    """One number that differs from sample to sample: where it stands, and its distribution or array of values."""

    path: NumberPath
    source: Number
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
            number = int(self.path[1])  # up to the last word there is, those of longer chains of blocks down from there
            return _FIRST_STATE + (number if number < _STATES_ABOVE else _STATES_ABOVE - 1 - number)
        return _FIRST_NAMED + zlib.crc32(self.name.encode()) % (_FIRST_STATE - _FIRST_NAMED)


class StochasticModel(NamedTuple):
    """A system, the law of its excitation, and its initial state."""

    system: Any
    law: Any
    y0: Any


@dataclasses.dataclass(frozen=True, eq=False)
class Inputs:
    """All inputs of an ensemble, and how they are drawn.

    - `model`: with the distributions and arrays in it. `names`: the short names of the inputs.
    - `design`: where uniform numbers and realisations come from, if not from the key. `copula`: which inputs depend on
      each other. `columns`, `correlated`: which entries these are about, in their order.
    """

    model: StochasticModel
    entries: tuple[Input, ...]
    names: tuple[str, ...]
    samples: int
    key_data: Array | None = None
    design: Design | None = None
    columns: tuple[int, ...] = ()
    copula: GaussianCopula | None = None
    correlated: tuple[int, ...] = ()

    @classmethod
    def of(
        cls, model: StochasticModel, samples: int | Design, key: Array | None, copula: GaussianCopula | None = None
    ) -> "Inputs":
        """The inputs in `model`, whose law is one of the package or a `SampledLaw`.

        Raises ValueError for arrays of another length than `samples`, names that fit no input, or a missing key.
        """
        design = samples if isinstance(samples, Design) else None
        samples = samples.samples if isinstance(samples, Design) else samples
        model = _with_columns(model, design)
        for name, value in model._asdict().items():
            checks.tree(name, value)
        entries = tuple(Input(path, *found) for path, *found in varying(model))
        for entry in entries:
            if not entry.is_random and len(entry.source) != samples:
                raise ValueError(
                    f"Argument {shown(entry.path)} must hold one number for each of the {samples} samples, but an "
                    f"array of {len(entry.source)} was given."
                )
        covered = design is not None and design.is_uniform and design.names is None
        if key is None and not covered and any(entry.is_random for entry in entries):
            demand = "be a key such as jax.random.key(0) where law, system or y0 are random"
            raise checks.refused("key", demand, None)
        streams = [entry.stream for entry in entries]
        assert len(set(streams)) == len(streams), "two names share a random word"
        # Short names: the shortest endings of the paths that no other path has, and that begin with a word.
        paths, names = [entry.path for entry in entries], []
        for path in paths:
            endings = (path[-size:] for size in range(1, len(path) + 1) if isinstance(path[-size], str))
            names.append(shown(next(end for end in endings if sum(other[-len(end) :] == end for other in paths) == 1)))
        # Which entries the columns of a design of uniform numbers, and a copula, are for.
        random = tuple(place for place, entry in enumerate(entries) if entry.is_random)

        def named(argument: str, names: tuple[str, ...]) -> tuple[int, ...]:
            return tuple(random[matching(argument, name, [paths[place] for place in random])] for name in names)

        columns = ()
        if design is not None and design.names is not None and design.is_uniform:
            columns = named("samples", design.names)
        elif design is not None and design.is_uniform:
            columns = random
            if len(random) != design.dimensions:
                raise ValueError(
                    f"Argument samples must be a design with one column for each of the {len(random)} random numbers "
                    f"({', '.join(entries[place].name for place in random)}), but it has {design.dimensions}; "
                    "give it names."
                )
        correlated = () if copula is None else named("correlation", copula.names)
        for place in (*columns, *correlated):
            if not _has_quantiles(entries[place].source):
                demand = "be a distribution with quantiles (icdf or ppf) to follow a design or a correlation"
                raise checks.refused(names[place], demand, entries[place].source)
        key_data = None if key is None else key_data_of(key)
        return cls(model, entries, tuple(names), samples, key_data, design, columns, copula, correlated)

    @property
    def are_random(self) -> bool:
        """Whether an input is drawn."""
        return any(entry.is_random for entry in self.entries)

    def drawn(self, first: int, number: int, dtype: DType) -> tuple[AnyArray, ...]:
        """The values of every input for samples ``first .. first + number - 1``, arrays (number,).

        Beyond the last sample, arrays repeat their last value.
        """
        samples = self._repeating_last(first, number)
        return tuple(
            np.asarray(entry.source, dtype)[samples] if u is None else self._quantiles(entry, u, first)
            for entry, u in zip(self.entries, self.uniforms(first, number, dtype), strict=True)
        )

    def _quantiles(self, entry: Input, u: Array, first: int) -> AnyArray:
        """The values of `entry` at the uniform numbers `u` of the samples from `first` on."""
        source = entry.source
        if isinstance(source, RandomNumber):
            return _of_distribution(source, u)
        for name, argument in (("ppf", np.asarray(u)), ("icdf", u)):
            if callable(getattr(source, name, None)):
                try:
                    values = np.asarray(getattr(source, name)(argument), u.dtype)
                except NotImplementedError:
                    continue  # some packages give every distribution the method, and few of them an answer
                if values.shape == u.shape:
                    return values
                raise ValueError(
                    f"Argument {entry.name} must be a distribution of one number, but {name} of {checks.show(source)} "
                    f"gave an array of shape {values.shape} for {len(u)} samples."
                )
        # A distribution that only samples: by keys of its own, one for each sample.
        assert self.key_data is not None
        samples = jnp.asarray(np.arange(first, first + len(u), dtype=np.uint32))
        own = random_words(random_words(self.key_data, samples), jnp.uint32(entry.stream))
        keys = jax.random.wrap_key_data(jnp.stack(own, axis=-1))
        return np.asarray(jax.vmap(source.sample)(keys), u.dtype)

    def with_start(self, y0: tuple[Number, ...]) -> "Inputs":
        """The same inputs; where none of them is an initial value, with the checked initial state `y0`."""
        in_start = any(entry.path[0] == "y0" for entry in self.entries)
        return self if in_start else dataclasses.replace(self, model=self.model._replace(y0=y0))

    def uniforms(self, first: int, number: int, dtype: DType) -> tuple[Array | None, ...]:
        """The uniform numbers that `drawn` draws from, (number,) each; None for arrays."""
        found: list[Any] = [None] * len(self.entries)
        if self.design is not None and self.columns:
            samples = self._repeating_last(first, number)
            rows, _ = self.design.block(int(samples[0]), int(samples[-1] - samples[0]) + 1, dtype)
            for place, column in zip(self.columns, rows[samples - samples[0]].T, strict=True):
                found[place] = jnp.asarray(column)
        own = [place for place, entry in enumerate(self.entries) if entry.is_random and found[place] is None]
        streams = np.array([self.entries[place].stream for place in own], np.uint32)
        if own:
            drawn = _uniforms(self.key_data, np.uint32(first), streams, number=number, dtype=dtype)
            for place, column in zip(own, drawn, strict=True):
                found[place] = column
        if self.copula is not None:
            u = jnp.stack([found[place] for place in self.correlated], axis=-1)
            for place, column in zip(self.correlated, _correlated(self.copula, u).T, strict=True):
                found[place] = column
        return tuple(found)

    def realization_numbers(self, first: int, number: int) -> np.ndarray:
        """Which realisation of the excitation samples ``first .. first + number - 1`` use; the last one repeated."""
        samples = self._repeating_last(first, number)
        return (samples if self.design is None else self.design.realization[samples]).astype(np.uint32)

    def _repeating_last(self, first: int, number: int) -> np.ndarray:
        """The samples ``first .. first + number - 1``; the last one in place of those beyond it."""
        return np.minimum(np.arange(first, first + number), self.samples - 1)

    @property
    def has_sampled_law(self) -> bool:
        """Whether every sample has a base motion of its own, as arrays, from an object of the user's."""
        return isinstance(self.model.law, SampledLaw)

    @property
    def has_own_realizations(self) -> bool:
        """Whether sample i uses realisation i of the excitation."""
        return self.design is None or bool(np.all(self.design.realization == np.arange(self.samples)))

    def realizations(self, first: int, number: int, t1: float) -> PyTree:
        """The realisations of a `SampledLaw` for these samples, stacked; None for other laws."""
        if not self.has_sampled_law:
            return None
        numbers = self.realization_numbers(first, number)
        used = max(1, min(number, self.samples - first))

        def keys():
            assert self.key_data is not None
            words = random_words(self.key_data, jnp.asarray(numbers[:used]))
            return jax.random.wrap_key_data(jnp.stack(words, axis=-1))

        found = self.model.law.realizations(keys, t1, used)
        check_realizations(found, first)
        return jax.tree.map(lambda leaf: leaf[np.minimum(np.arange(number), used - 1)], found)

    def head(self, samples: int) -> StochasticModel:
        """The model of the first `samples` samples."""
        return self.filled([entry.source if entry.is_random else entry.source[:samples] for entry in self.entries])

    def filled(self, values: Any) -> StochasticModel:
        """The model with one value for each input."""
        return with_numbers(self.model, tuple(entry.path for entry in self.entries), values)

    def of_sample(self, number: int, dtype: DType) -> StochasticModel:
        """The model of sample `number`, with plain numbers."""
        return self.filled([float(value[0]) for value in self.drawn(number, 1, dtype)])

    def realization_of(self, number: int, law: Any, t1: float) -> Any:
        """The realisation of the random `law` that sample `number` uses."""
        words = jax.random.wrap_key_data(jnp.asarray(self.key_data, jnp.uint32))
        return law.sample(jax.random.fold_in(words, int(self.realization_numbers(number, 1)[0])), t1)

    def values(self, dtype: DType, first_sample: int = 0) -> dict[str, np.ndarray]:
        """The values of samples from `first_sample` on by the inputs' short names, arrays (samples,)."""
        parts = [self.drawn(first, _AT_ONCE, dtype) for first in range(first_sample, self.samples, _AT_ONCE)]
        columns = [np.concatenate([np.asarray(part[i]) for part in parts]) for i in range(len(self.entries))]
        number = self.samples - first_sample
        return {name: column[:number] for name, column in zip(self.names, columns, strict=True)}

    def check(self, dtype: DType) -> None:
        """Check all values against the bounds of their fields. Raises ValueError that says how many are outside."""
        for first in range(0, self.samples if self.entries else 0, _AT_ONCE):
            number = min(_AT_ONCE, self.samples - first)
            drawn = [np.asarray(column)[:number] for column in self.drawn(first, _AT_ONCE, dtype)]
            for entry, name, values in zip(self.entries, self.names, drawn, strict=True):
                about = entry.about or Quantity()
                wrong = about.outside(values)
                if not np.any(wrong):
                    continue
                at = int(np.argmax(wrong))
                if not entry.is_random:
                    about.check(f"{name}[{first + at}]", float(values[at]))
                try:
                    about.check(name, float(values[at]))
                except ValueError as error:
                    raise ValueError(
                        f"Argument {name} must be a distribution within the bounds of {name}, but "
                        f"{np.count_nonzero(wrong)} of the draws {first} to {first + number - 1} are outside, first "
                        f"that of sample {first + at}; restrict it with Truncated(..., low=..., high=...). {error}"
                    ) from error
            self._check_relations(drawn, first)

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
                inside = [place for place, path in enumerate(paths) if path[: len(depth)] == depth]
                own = tuple(paths[place][len(depth) :] for place in inside)
                for sample in range(len(drawn[0])):
                    one = with_numbers(module, own, [float(drawn[place][sample]) for place in inside])
                    try:
                        type(one).check_relations(one)
                    except ValueError as error:
                        raise ValueError(f"Sample {first + sample} does not fit: {error}") from error


@kept_jit
def _of_distribution(distribution: RandomNumber, u: Array) -> Array:
    return jnp.asarray(distribution.icdf(u), u.dtype)


_correlated = kept_jit(lambda copula, u: copula.correlated(u))


@kept_jit(static_argnames=("number", "dtype"))
def _uniforms(key_data: Array, first: Array, streams: Array, *, number: int, dtype: DType) -> Array:
    """Uniform numbers (streams, number) of samples ``first, first + 1, ...``."""
    own = random_words(key_data, first + jnp.arange(number, dtype=jnp.uint32))
    return jax.vmap(lambda stream: uniform(random_words(own, stream)[0], dtype))(streams)


def _has_quantiles(source: object) -> bool:
    return not isinstance(source, type) and any(callable(getattr(source, name, None)) for name in ("icdf", "ppf"))


def _with_columns(model: StochasticModel, design: Design | None) -> StochasticModel:
    """The model with a column for each coordinate, where `y0` is an array (samples, coordinates), and with the columns
    of a design of values in place of the numbers that they are named after.
    """
    y0 = model.y0
    if is_distribution(y0):  # which cannot be that of all coordinates
        demand = "hold a number or a distribution for each number of the state, as (Uniform(0.0, 1.0), 0.0)"
        raise checks.refused("y0", demand, y0)
    if isinstance(y0, (tuple, list)):
        model = model._replace(y0=tuple(y0))
    elif checks.dimensions(y0) == 2:  # (samples, coordinates): a column for each coordinate
        model = model._replace(y0=tuple(checks.numbers("y0", y0).T))
    if design is not None and design.values is not None:  # they stand for the numbers that they are named after
        if design.names is None:
            raise ValueError("Argument samples must be a design whose values have names of numbers, such as 'mu'.")
        known = [path for path, _ in numbers_in(model._asdict(), whole=True)]
        paths = tuple(known[matching("samples", name, known)] for name in design.names)
        for path in paths:  # an optional number that is not set has no place in the tree
            if number_at(model, path) is None:
                raise checks.refused(shown(path), "be a number where a design varies it", None)
        model = with_numbers(model, paths, [np.array(column) for column in design.values.T])
    return model


def varying(tree: Any, path: NumberPath = (), about: Any = None) -> Iterator[tuple[NumberPath, Any, Quantity | None]]:
    """Path, distribution or array, and field of every input in `tree`."""
    if isinstance(tree, RandomNumber) or (about is not None and varies(tree, about)):
        yield path, tree, about
    elif isinstance(tree, eqx.Module):
        abouts, own = described(type(tree)), getattr(tree, "own_distributions", ())
        for field in dataclasses.fields(tree):
            if not field.metadata.get("static", False) and field.name not in own:
                yield from varying(getattr(tree, field.name), (*path, field.name), abouts.get(field.name))
    elif isinstance(tree, StochasticModel):
        for name, part in tree._asdict().items():
            yield from varying(part, (name,))
    elif isinstance(tree, (tuple, list)):
        for index, value in enumerate(tree):
            yield from varying(value, (*path, index), Quantity() if path == ("y0",) else None)
    elif _has_quantiles(tree):
        yield path, tree, None
