"""The switch that turns all of this folder off."""

import os

VARIABLE = "STICKSLIP_PLAIN_JAX"
"""The environment variable; it is read once, when the package is imported."""
PLAIN = os.environ.get(VARIABLE, "0") not in ("", "0")
"""Whether the package uses ``jax.jit`` and nothing beyond it: slower, and equal but for round-off."""
