"""The law of base velocity that the documentation of `SegmentLaw` writes."""

import inspect
import math
import textwrap
from typing import Annotated

import jax
import jax.numpy as jnp

import stickslip_jax as ss


def documented_law():
    """The class in the documentation of `SegmentLaw`, and the lines that use it."""
    lines = inspect.getdoc(ss.SegmentLaw).partition("Attributes:")[0].splitlines()
    code = textwrap.dedent("\n".join(line for line in lines if line.startswith("    ") or not line))
    made, used = code.split("law = ")
    names = {"ss": ss, "jnp": jnp, "jax": jax, "math": math, "Annotated": Annotated}
    exec(made, names)
    return names["Ramps"], "law = " + used, names
