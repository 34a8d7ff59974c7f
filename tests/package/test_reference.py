"""The reference pages hold every public name once."""

import re
from pathlib import Path

import stickslip_jax as ss
from stickslip_jax import design, nonlinear, plot

PAGES = sorted((Path(__file__).parents[2] / "docs" / "reference").glob("*.md"))
DIRECTIVE = r"^\.\. (?:auto\w+|py:data):: (\w+)$|^\.\. currentmodule:: (\S+)$"


def shown():
    names = []
    for page in PAGES:
        module = ""
        for name, now in re.findall(DIRECTIVE, page.read_text(encoding="utf-8"), re.MULTILINE):
            module = module if name else now
            names += [f"{module}.{name}"] if name else []
    return names


def test_every_public_name_has_its_place():
    found = shown()
    assert len(found) == len(set(found))
    wanted = {f"stickslip_jax.{name}" for name in ss.__all__}
    wanted |= {f"stickslip_jax.design.{name}" for name in design.__all__}
    wanted |= {f"stickslip_jax.nonlinear.{name}" for name in nonlinear.__all__}
    wanted |= {f"stickslip_jax.plot.{name}" for name in plot.__all__}
    assert not wanted - set(found)
