"""Parameters by name: numbers in a system, its excitation and its initial state; and those in realisations."""

import dataclasses
import difflib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .._foundation import checks
from .._foundation.fields import Quantity, check_again, described, is_distribution, modules_in

# Parameters by name: numbers in a system, its excitation and its initial state.


NumberPath = tuple[str | int, ...]


class Parameter(NamedTuple):
    """A number that can be varied: its name as the caller gave it, its path, and its value."""

    name: str
    path: NumberPath
    value: float


def parameters_of(
    where: Mapping[str, object], wrt: object, others: Mapping[str, Parameter] = {}
) -> tuple[Parameter, ...]:
    """The parameters named by `wrt`, a name or several; `others` that may be named, too, by their full names.

    `where` holds the objects to search: "system", "law" and "y0". A parameter's name is that of a field, such as "mu"
    or "rate"; where several fields have it, with the names before it, as in "law.speed". Initial values are "y0[0]",
    "y0[1]" and so on. Raises ValueError for a name that fits no number, or several.
    """
    names = (wrt,) if isinstance(wrt, str) else tuple(wrt) if isinstance(wrt, (tuple, list)) else ()
    if not names or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise checks.refused("wrt", "be a parameter's name or several different ones", wrt)
    known = list(numbers_in(where))
    found = []
    for name in names:
        if name in others:
            found.append(others[name])
            continue
        path, value = known[matching("wrt", name, [path for path, _ in known])]
        if value is None:
            raise ValueError(
                f"Argument wrt must name numbers that are set, but {name!r} is not; give it a value, a zero as "
                "jnp.asarray(0.0)."
            )
        found.append(Parameter(name, path, float(value)))
    return tuple(found)


def number_at(tree: Any, path: NumberPath) -> Any:
    """The number of `tree` at `path`."""
    for step in path:
        tree = tree[step] if isinstance(step, int) else getattr(tree, step)
    return tree


def quantity_at(tree: Any, path: NumberPath) -> Quantity:
    """What is known of the number of `tree` at `path`, its unit and bounds; an empty `Quantity` where nothing is."""
    holder = number_at(tree, path[:-1])
    about = described(type(holder)).get(str(path[-1])) if dataclasses.is_dataclass(holder) else None
    return about if isinstance(about, Quantity) else Quantity()


def with_numbers(tree: Any, paths: Sequence[NumberPath], values: Any) -> Any:
    """`tree` with the numbers at `paths` replaced, also those that were None."""
    if not paths:
        return tree
    return eqx.tree_at(
        lambda tree: [number_at(tree, path) for path in paths], tree, [values[i] for i in range(len(paths))],
        is_leaf=lambda leaf: leaf is None,
    )  # fmt: skip


def leaves_of_numbers(build: Callable[[Any], PyTree], tree: Any, paths: Sequence[NumberPath]) -> tuple[int, ...]:
    """Which leaves of ``build(tree)`` are the numbers of `tree` at `paths`; these must be among them as they are."""
    marks = [np.float64(number_at(tree, path)) for path in paths]  # objects of their own
    leaves = jax.tree.leaves(build(with_numbers(tree, paths, marks)))
    return tuple(next(place for place, leaf in enumerate(leaves) if leaf is mark) for mark in marks)


def check_numbers(tree: object) -> None:
    """Run the constructor's checks of all modules in `tree` again. Raises their ValueError."""
    for module in reversed(list(modules_in(tree))):  # those inside others first
        check_again(module)


def matching(argument: str, name: str, paths: list[NumberPath]) -> int:
    """The position in `paths` of the number called `name`, in full or by the end of its path.

    Raises ValueError, about `argument`, for a name that fits none of them, or several.
    """
    names = [shown(path) for path in paths]
    fits = [i for i, full in enumerate(names) if full == name or full.endswith(f".{name}")]
    if len(fits) == 1:
        return fits[0]
    if fits:
        several = ", ".join(names[i] for i in fits)
        raise ValueError(f"Argument {argument} must be unambiguous, but {name!r} fits {several}; give the full name.")
    endings = sorted({full.rpartition(".")[2] for full in names} | set(names))
    inner = [f"{name}.{full.rpartition(f'.{name}.')[2]}" for full in names if f".{name}." in full]
    near = inner or difflib.get_close_matches(name, endings, n=1)
    hint = f" did you mean {checks.one_of(map(repr, near))}?" if near else ""
    raise ValueError(
        f"Argument {argument} must name one of {', '.join(names) or 'no number at all'}, but {checks.show(name)} was "
        f"given{';' if hint else '.'}{hint}"
    )


def paths_of_numbers(where: Mapping[str, object]) -> Iterator[NumberPath]:
    """Paths of all numbers, those in distributions too, and of optional numbers that are not set, in the objects by
    name.
    """
    return (path for path, _ in numbers_in(where))


def numbers_in(where: Mapping[str, object], *, whole: bool = False) -> Iterator[tuple[NumberPath, Any]]:
    """Paths and values of all numbers in the objects by name; None for optional numbers that are not set.

    `whole`: yield a distribution itself, not the numbers in it, and arrays in place of numbers too.
    """
    for root, tree in where.items():
        yield from _numbers(tree, (root,), whole)


def _numbers(tree: object, path: NumberPath, whole: bool) -> Iterator[tuple[NumberPath, Any]]:
    is_law = isinstance(tree, eqx.Module) and not callable(getattr(tree, "icdf", None))
    if whole and is_distribution(tree) and not is_law:
        yield path, tree
    elif isinstance(tree, eqx.Module):
        for field in dataclasses.fields(tree):
            if not field.metadata.get("static", False):
                value = getattr(tree, field.name)
                if value is None and field.name in ("damping", "mu_static"):
                    yield (*path, field.name), None
                else:
                    inside = field.name in getattr(tree, "own_distributions", ())
                    yield from _numbers(value, (*path, field.name), whole and not inside)
    elif isinstance(tree, (tuple, list)):
        for index, value in enumerate(tree):
            yield from _numbers(value, (*path, index), whole)
    elif _is_number(tree) or (whole and isinstance(tree, np.ndarray) and tree.ndim == 1):
        yield path, tree


def _is_number(value: object) -> bool:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.number, np.ndarray, jax.Array)):
        return False
    if np.ndim(value) != 0 or (isinstance(value, int) and not -(2**63) <= value < 2**63):
        return False
    kind = jnp.result_type(value)
    if not jnp.issubdtype(kind, jnp.number) or jnp.issubdtype(kind, jnp.complexfloating):
        return False
    return not np.ma.is_masked(value) and math.isfinite(float(value))


def shown(path: NumberPath) -> str:
    """The path as users write it: "system.friction.mu", "y0[0]"."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).lstrip(".")


# Checks of the realisations that a law of a user's drew while JAX traced it, when constructors check no numbers.


def check_realizations(found: PyTree, first: int) -> None:
    """Check stacked realisations, those of samples `first`, ``first + 1``, ... Raises ValueError for the first of them
    that its constructors would have refused.
    """
    # Which of them the constructors may refuse: looked at all at once.
    suspicious = np.zeros(len(jax.tree.leaves(found)[0]), bool)
    for module in modules_in(found):
        arrays = {field.name: getattr(module, field.name) for field in dataclasses.fields(module)}
        arrays = {name: np.asarray(array) for name, array in arrays.items() if np.ndim(array) > 0}
        for name, about in described(type(module)).items():
            if name in arrays and isinstance(about, Quantity):
                suspicious |= _any(about.outside(arrays[name]))
        if "times" in arrays:
            times = arrays["times"]
            suspicious |= _any(np.diff(times, axis=-1) <= 0) | (times[..., 0] != 0)
        if "durations" in arrays:
            durations = arrays.pop("durations")
            used = durations > 0
            suspicious |= _any(~(durations >= 0)) | _any(used[..., 1:] & ~used[..., :-1])
            for name, values in arrays.items():
                suspicious |= _any(used & ~np.isfinite(values))
                if name == "velocities":
                    suspicious |= _any((values[..., 1:] == values[..., :-1]) & used[..., 1:])
    for sample in np.flatnonzero(suspicious):
        one = jax.tree.map(lambda leaf, sample=sample: leaf[sample], found)
        try:
            check_numbers(one)
        except ValueError as error:
            raise ValueError(
                f"Argument law must give realisations that fit, but sample {first + sample}: {error}"
            ) from error


def _any(wrong: np.ndarray) -> np.ndarray:
    return np.any(wrong.reshape(len(wrong), -1), axis=1)
