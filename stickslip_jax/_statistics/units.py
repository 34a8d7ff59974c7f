"""Units of products and quotients of estimates."""

import re

_FACTOR = re.compile(r"([^\d\s/^*()-]+)(?:\^?(-?\d+))?")


def unit_of_product(one: str, other: str, power: int = 1) -> str:
    """The unit of a quantity in `one` times a quantity in `other` to the `power` 1 or -1, such as "m/s" times "s": "m".

    Units that are no products of powers, such as "s per stick", stay as they are, in parentheses.
    """
    powers = dict(_powers(one))
    for name, exponent in _powers(other).items():
        powers[name] = powers.get(name, 0) + power * exponent
    above = [_shown(name, exponent) for name, exponent in powers.items() if exponent > 0]
    below = [_shown(name, -exponent) for name, exponent in powers.items() if exponent < 0]
    if not below:
        return " ".join(above) or "1"
    return f"{' '.join(above) or '1'}/{below[0] if len(below) == 1 else '(' + ' '.join(below) + ')'}"


def same_unit(one: str, other: str) -> bool:
    """Whether two units are the same, however their factors are ordered."""
    return _powers(one) == _powers(other)


def _powers(unit: str) -> dict[str, int]:
    """The exponent of each factor."""
    powers: dict[str, int] = {}
    for place, part in enumerate(unit.split("/")):
        for factor in part.strip().removeprefix("(").removesuffix(")").replace("*", " ").split():
            found = _FACTOR.fullmatch(factor)
            if found and factor != "per":
                exponent = int(found[2] or 1) * (-1 if place else 1)
                powers[found[1]] = powers.get(found[1], 0) + exponent
            elif factor != "1":
                return {f"({unit.strip().removeprefix('(').removesuffix(')')})": 1}
    return {name: exponent for name, exponent in powers.items() if exponent}


def _shown(name: str, exponent: int) -> str:
    return name if exponent == 1 else f"{name}^{exponent}"
