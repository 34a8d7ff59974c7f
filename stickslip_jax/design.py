"""Designs: which numbers, and which realisation of the base, each sample of an ensemble takes.

``simulate_ensemble(..., samples=design)`` simulates a sample for each row of a `Design`. In designs of uniform numbers,
the numbers that differ are given to the system, law or start as distributions, which make their values from the
uniform ones:

- `random`: independent. `latin_hypercube`, `sobol`: spread more evenly, for smaller errors with the same samples.
- `saltelli`: for the Sobol' indices of `stickslip_jax.sobol_indices`.

In designs of values, these take the place of the numbers that stand there:

- `grid`: all combinations. `table`: any table, such as a DataFrame or the design matrix of another program.
"""

from ._uncertainty.design import Design, grid, latin_hypercube, random, saltelli, sobol, table

__all__ = ["Design", "grid", "latin_hypercube", "random", "saltelli", "sobol", "table"]
