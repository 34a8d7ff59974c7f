"""`concatenate` joins ensembles, `load` reads one from a file."""

import itertools
import os
from collections.abc import Callable, Sequence
from typing import Any

from .. import _checks
from .data import Fields, Origin, same_object
from .origins import origins_of
from .parts import EnsembleAccumulator
from .result import Ensemble
from .stored import fields_of_file
from .unknown import Unknown, UnknownSystem


def load(path: str | os.PathLike[str]) -> Ensemble:
    """Read an ensemble that `Ensemble.save` or ``stickslip study`` wrote.

    Args:
        path: The file, or the folder of a study.

    Returns:
        The `Ensemble` with the statistics it had, to the last bit; figures, ``realization(i)`` and ``extended`` work as
        before. Objects of your own classes (systems, laws, distributions) come back as stand-ins that hold their name
        and how they printed: statistics and figures of the sticks still work, what needs the object raises ValueError.

    Raises:
        FileNotFoundError: For a missing file.
        ValueError: For one that is damaged or cut short, of another program, or of a newer format.
        ImportError: Without the extra ``study``.
    """
    return Ensemble(**fields_of_file(_checks.path("path", path, "a file name")))


def concatenate(ensembles: Sequence[Ensemble]) -> Ensemble:
    """Join ensembles into one, whose samples are those of the first, then of the second, and so on.

    Where samples follow each other (the same system, law, method, start and key, and ``first_sample`` of one is the
    number after the last of the one before), the result is that of one run. Otherwise `origins` holds where each part
    came from, and ``realization(i)`` looks there; what differs from part to part is `Unknown` in the result, so that it
    cannot be extended. Sticks and counts are those of the parts to the last bit; means and other sums differ from those
    of one run by round-off only, since they are merged from sums.

    Args:
        ensembles: At least one, of the same duration, `keep`, `orders`, `count_initial_rest`, dtype, and kind of
            position. Their systems, laws, keys, methods and starts may differ.

    Raises:
        ValueError: For anything else, and for parts that hold the same random samples twice.
    """
    if not isinstance(ensembles, Sequence) or not ensembles or not all(isinstance(one, Ensemble) for one in ensembles):
        raise _checks.refused("ensembles", "be a list of results of simulate_ensemble", ensembles)
    for what in ("t1", "keep", "numbering", "dtype"):
        _check_same(what, [getattr(one, what) for one in ensembles])
    _check_same("outputs", [dict(sorted(one.output_units.items())) for one in ensembles])
    _check_same("counted", [getattr(one.system, "counted_contact", None) for one in ensembles])
    _check_same("position", [one.system.stick_position[1::2] for one in ensembles])
    accumulator = EnsembleAccumulator(sum(one.samples for one in ensembles), ensembles[0].keep)
    for one in ensembles:
        accumulator.add_ensemble(one)
    origins = _joined([origin for one in ensembles for origin in origins_of(one)])
    return Ensemble(
        t1=ensembles[0].t1,
        numbering=ensembles[0].numbering,
        dtype=ensembles[0].dtype,
        **_common(origins),
        **accumulator.found(),
        output_units=dict(ensembles[0].output_units),
        output_functions=_shared_functions(ensembles),
        threads=max(one.threads for one in ensembles),
        compile_seconds=sum(one.compile_seconds for one in ensembles),
        run_seconds=sum(one.run_seconds for one in ensembles),
    )


def _shared_functions(ensembles: Sequence[Ensemble]) -> dict[str, Callable[..., Any]]:
    """The functions of outputs that are the same object in all of the ensembles."""
    first, *others = (one.output_functions for one in ensembles)
    return {name: function for name, function in first.items() if all(one.get(name) is function for one in others)}


_WORDS = {
    "t1": "duration t1",
    "outputs": "names and units of outputs",
    "position": "unit and period of the position",
    "counted": "contact whose sticks are counted",
}


def _check_same(what: str, values: Sequence[object]) -> None:
    for number, value in enumerate(values):
        if value != values[0]:
            raise ValueError(
                f"Argument ensembles must have the same {_WORDS.get(what, what)}, but the first has "
                f"{_checks.show(values[0])} and ensembles[{number}] has {_checks.show(value)}."
            )


def _joined(origins: list[Origin]) -> tuple[Origin, ...]:
    """The origins, those that follow each other made one. Raises ValueError if one holds samples of another."""
    for one, other in itertools.combinations(origins, 2):
        apart = one.first_sample + one.samples <= other.first_sample
        apart = apart or other.first_sample + other.samples <= one.first_sample
        if one.key_data is not None and not apart and one.same_run(other):
            raise ValueError(
                "Argument ensembles must hold different samples, but two parts have the same key and samples "
                f"{max(one.first_sample, other.first_sample)} and on; simulate them with different keys, or with "
                "first_sample=... after one another."
            )
    joined = origins[:1]
    for origin in origins[1:]:
        last = joined[-1]
        if origin.follows(last):
            joined[-1] = last._replace(samples=last.samples + origin.samples)
        else:
            joined.append(origin)
    return tuple(joined)


def _common(origins: tuple[Origin, ...]) -> Fields:
    """The fields of an `Ensemble` that its origins give; `Unknown` for what differs among them."""
    first = origins[0]
    samples = sum(origin.samples for origin in origins)
    if len(origins) == 1:
        return {**first._asdict(), "samples": samples, "origins": ()}
    found: Fields = {}
    for name in ("system", "law", "method", "y0"):
        values = [getattr(origin, name) for origin in origins]
        same = all(same_object(value, values[0]) for value in values)
        found[name] = values[0] if same else Unknown(f"differs among the {len(origins)} parts")
    if isinstance(found["system"], Unknown):
        found["system"] = UnknownSystem(found["system"].name, "", first.system.stick_position)
    if isinstance(found["y0"], Unknown):
        found["y0"] = (found["y0"],)
    return {**found, "key_data": None, "first_sample": 0, "samples": samples, "origins": origins}
