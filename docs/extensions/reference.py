"""What the reference shows of docstrings and classes: links to pages, and the members that a user calls or writes.

Internal is what systems, laws and engines say to each other: whoever changes these finds it in the sources.
"""

import inspect
import re

INTERNAL = """
    check check_code check_excitation check_parts check_relations check_solver checked_capacity
    coordinates stick_position angle_scale longest_response
    switched_model time_scales sizes memory tracks traits recorded look
    has_contacts has_static_ratio static_exceeds_kinetic continued_coefficient
    depends_on_direction in_direction slip_coefficient stick_limit viscous_slope
    all_intervals all_segments gap_rate level_probabilities uniforms key_data realized realized_until users
    covered_time tones varies enough_harmonics in_lanes next_interval next_segment
    known missing unit_of distributions cells_of_retained line labeled outside model_config
    require_sticks numbered_sticks finished_sticks without_name
""".split()  # noqa: SIM905


def _linked(app, what, name, obj, options, lines) -> None:
    """The name of a document in a docstring becomes a link to its page."""
    lines[:] = [re.sub(r"(?:``)?docs/([\w/]+)\.md(?:``)?", r":doc:`/\1`", line) for line in lines]


def _hides_internal(app, what, name, obj, skip, options) -> bool | None:
    """Leave out what systems, laws and engines ask each other."""
    return True if name in INTERNAL else None


def _inherited(cls: type, name: str) -> bool:
    return any(name in vars(base) for base in cls.__mro__[1:] if base.__module__.startswith("stickslip_jax"))


def _hides_overrides(app, what, name, obj, skip, options) -> bool | None:
    """Leave out what only fulfils a base class: the base class says what it does."""
    function = obj.fget if isinstance(obj, property) else inspect.unwrap(getattr(obj, "__func__", obj))
    qualified = getattr(function, "__qualname__", "")
    module = inspect.getmodule(function)
    owner, _, member = qualified.rpartition(".")
    cls = getattr(module, owner, None) if module is not None and owner and "." not in owner else None
    if member == name and inspect.isclass(cls) and _inherited(cls, name):
        return True
    return None


def setup(app) -> dict[str, bool]:
    """What Sphinx calls first."""
    app.connect("autodoc-process-docstring", _linked)
    app.connect("autodoc-skip-member", _hides_internal)
    app.connect("autodoc-skip-member", _hides_overrides)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
