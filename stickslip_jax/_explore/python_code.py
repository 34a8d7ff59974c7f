"""What the explorer shows as a Python program that runs as it is."""

import dataclasses
import sys
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .scene import Scene

_PACKAGE = __name__.partition(".")[0]
_WIDTH = 88


class NotWritable(ValueError):
    """Raised for what has no expression in Python that a program could hold."""


def as_python(scene: Scene) -> str:
    """A program that simulates the same ensemble, prints its statistics and draws its first realisation.

    Raises NotWritable for a system or base made of something else than numbers and objects with fields.
    """
    imports: set[tuple[str, str]] = set()
    parts = {
        name: _assigned(name, _expression(getattr(scene, name), imports)) for name in ("system", "law", "y0", "method")
    }
    if scene.method == Scene._field_defaults["method"]:
        parts["method"], option = "", ""
    else:
        option = ", method=method"
    own = "".join(f"from {module} import {name}\n" for module, name in sorted(imports) if module != "__main__")
    x64 = "True" if jnp.result_type(float) == jnp.float64 else "False"
    return f"""\
import jax

jax.config.update("jax_enable_x64", {x64})

import stickslip_jax as ss
{own}
{parts["system"]}{parts["law"]}{parts["y0"]}{parts["method"]}
many = ss.simulate_ensemble(
    system, law, t1={scene.t1!r}, samples={scene.samples},
    key=jax.random.key({scene.seed}), y0=y0{option},
)
print(ss.mean_stick_duration(many))
print(ss.mean_stick_count(many))
print(ss.stick_fraction(many))

first_system, base, start = many.realization(0)
one = ss.simulate(first_system, base, t1={scene.t1!r}, y0=start{option})
ss.plot.save(ss.plot.phase_portrait(one), "phase_portrait.png", overwrite=True)
"""


def _assigned(name: str, value: str) -> str:
    return f"{name} = {value}\n"


def _expression(value: Any, imports: set[tuple[str, str]], indent: int = 0) -> str:
    """The Python expression of a value; classes of others are added to `imports`."""
    if isinstance(value, (bool, int, float, str)) or value is None:
        return repr(value)
    if isinstance(value, np.number):
        return repr(value.item())
    if isinstance(value, (np.ndarray, jax.Array)):
        return repr(np.asarray(value).tolist())
    if isinstance(value, tuple):
        return _call("", [_expression(one, imports, indent + 4) for one in value], indent, comma=len(value) == 1)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        given = [
            f"{field.name}={_expression(getattr(value, field.name), imports, indent + 4)}"
            for field in dataclasses.fields(value)
            if field.init and not _is_default(field, getattr(value, field.name))
        ]
        return _call(_class_name(type(value), imports), given, indent)
    raise NotWritable(f"{type(value).__name__} cannot be written as Python; keep the program that made it.")


def _call(name: str, arguments: list[str], indent: int, comma: bool = False) -> str:
    line = f"{name}({', '.join(arguments)}{',' if comma else ''})"
    if "\n" not in line and len(line) + indent <= _WIDTH - 12:
        return line
    inside = "".join(f"{' ' * (indent + 4)}{one},\n" for one in arguments)
    return f"{name}(\n{inside}{' ' * indent})"


def _is_default(field: Any, value: Any) -> bool:
    if field.default is dataclasses.MISSING:
        return False
    return bool(eqx.tree_equal(field.default, value))


def _class_name(kind: type, imports: set[tuple[str, str]]) -> str:
    if kind.__module__.partition(".")[0] == _PACKAGE:
        if getattr(sys.modules[_PACKAGE], kind.__name__, None) is not kind:
            raise NotWritable(f"{kind.__name__} has no public name; keep the program that made it.")
        return f"ss.{kind.__name__}"
    if "." in kind.__qualname__:
        raise NotWritable(f"{kind.__qualname__} is defined in a function, where no program can import it.")
    imports.add((kind.__module__, kind.__qualname__))
    return kind.__name__
