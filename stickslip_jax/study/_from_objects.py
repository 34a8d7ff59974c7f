"""A study's file from the objects that a simulation takes: the way back of `build`."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from pydantic import ValidationError

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._excitation.random import RandomPhase
from .._fields import described
from .._systems.structure import LinearStructure
from .._systems.system import System
from .._uncertainty.families import Uniform
from ._bases_config import BaseConfig
from ._config import StudyConfig
from ._errors import StudyError
from ._forces_config import FrictionConfig, NormalForceConfig, NumberOrForce
from ._sections import Section, kinds_in, tag_key
from ._systems_config import SystemConfig

_KEYS = ("step", "max_steps", "width", "shape")
"""Of the section [run] that are fields of a method too."""


def config_of(
    system: System,
    law: Any,
    *,
    y0: tuple[Any, ...] | None,
    t1: float,
    samples: int,
    seed: int,
    method: Exact | Regularized = EXACT,
) -> StudyConfig:
    """The description of a study of these objects.

    Raises:
        StudyError: For objects that no section of a study's file describes, such as classes of a user's own; so what
            is described is what was given.
    """
    table = _system_table(system)
    run: dict[str, Any] = {"t1": float(t1), "samples": samples, "seed": seed, **_method_keys(method)}
    run["dtype"] = str(jnp.result_type(float))
    if y0 is not None:
        starts = [_start(one) for one in y0]
        kind = StudyConfig.runs[kinds_in(SystemConfig)[table["model"]]]
        run |= dict(zip(kind.initial, starts, strict=True)) if kind.initial else {"initial_state": starts}
    base = _table(law, kinds_in(BaseConfig))
    try:
        config = StudyConfig.model_validate({"system": table, "base": base, "run": run})
    except ValidationError as error:
        said = error.errors()[0]
        raise StudyError(f"No study's file can hold this: {said['msg']} ({'.'.join(map(str, said['loc']))}).") from None
    again = config.system.build(), config.base.build(), config.run.method(config.system.has_inner_states)
    for name, one, other in zip(("system", "base", "method"), (system, law, method), again, strict=True):
        if not eqx.tree_equal(jax.tree.map(_plain, one), jax.tree.map(_plain, other)):
            raise StudyError(f"No study's file can hold this {name}, but one that differs; copy it as Python instead.")
    return config


def _method_keys(method: Exact | Regularized) -> dict[str, Any]:
    """The keys of the section [run] that say how is simulated."""
    found = {key: getattr(method, key, None) for key in _KEYS}
    if method.solver is not None:
        found["solver"] = type(method.solver).__name__
    return {key: _plain(value) for key, value in found.items() if value is not None}


def _start(value: Any) -> Any:
    return {"low": float(value.low), "high": float(value.high)} if isinstance(value, Uniform) else _plain(value)


def _system_table(system: Any) -> dict[str, Any]:
    if type(system) is not LinearStructure:
        return _table(system, kinds_in(SystemConfig))
    counted = system.counted_track
    normal_forces, frictions = kinds_in(NormalForceConfig), kinds_in(FrictionConfig)
    contacts = [
        {
            "direction": _plain(one.direction),
            "normal_force": _table(one.normal_force, normal_forces),
            "friction": _table(one.friction, frictions),
            "on_base": _plain(one.on_base),
        }
        for one in system.contacts
    ]
    table = {
        "model": "LinearStructure",
        "mass": _plain(system.mass),
        "stiffness": _plain(system.stiffness),
        "rotates": system.rotates,
        "contact": "all" if counted in (None, -1) else counted,
        "contacts": contacts,
    }
    if system.damping is not None:
        table["damping"] = _plain(system.damping)
    if system.force is not None:
        table["force"] = [0.0 if one is None else _table(one, kinds_in(NumberOrForce)) for one in system.force]
    return table


def _table(value: Any, kinds: Mapping[str, type[Section]]) -> Any:
    """The section or number that describes `value`. `kinds`: the sections that may stand here, by name."""
    if isinstance(value, RandomPhase):
        table = _table(value.signal, kinds)
        return {key: entry for key, entry in table.items() if key not in ("phase", "phases")} | {"random_phase": True}
    if not isinstance(value, eqx.Module):
        return _plain(value)
    name = type(value).__name__
    kind = kinds.get(name)
    if kind is None or getattr(kind, "described_class", type(value)) is not type(value):
        raise StudyError(f"{name} has no section in a study's file; copy it as Python instead.")
    tag = tag_key(kind)
    table: dict[str, Any] = {} if tag is None else {tag: name}
    known = described(type(value))
    for key, info in kind.model_fields.items():
        name_of_field = "law" if key == "slip" else key
        entry = getattr(value, name_of_field, None) if key in known or key not in ("mu", tag) else None
        if entry is not None and key != tag:
            table[key] = _table(entry, kinds_in(info.annotation))
    if "random_phase" in kind.model_fields:
        table["random_phase"] = False
    return table


def _plain(value: Any) -> Any:
    """Numbers and lists of them, as TOML holds them."""
    if isinstance(value, (bool, str, int, float)) or value is None:
        return value
    if isinstance(value, (tuple, list)) or np.ndim(value) > 0:
        return [_plain(one) for one in np.asarray(value).tolist()]
    try:
        return float(value)
    except (TypeError, ValueError):
        raise StudyError(f"{type(value).__name__} has no key in a study's file; copy it as Python instead.") from None
