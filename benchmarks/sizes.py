"""How much work the cases do."""

from typing import NamedTuple


class Sizes(NamedTuple):
    """Numbers of samples, and the horizon of what runs in time steps (s)."""

    samples: int
    vmapped: int
    vmapped_stepped: int
    stepped: int
    stepped_t1: float
    carts: int
    cart_t1: float
    switched_t1: float
    """Horizon on switching bases, of derivatives."""
    regularized_share: int
    """One of so many of the trajectories of regularised dynamics."""
    sensitivity: int
    harmonics: tuple[int, int, int]
    """Components: of an ensemble that is timed, and of two whose compilation is."""
    sensitivity_compiled: int
    two_blocks: int
    """Samples of two blocks on a belt."""
    chains: tuple[int, ...]
    """Lengths of chains of blocks."""
    chains_by_numba: tuple[int, ...]
    """Those of them that a scalar loop follows too."""
    chain_blocks: int
    """Blocks in all samples of a chain."""
    shaken: int
    """Samples of a building under a record."""
    blocks_t1: float
    """Horizon of blocks on a belt."""
    diagrams: tuple[int, ...]
    """Values of the parameter of bifurcation diagrams."""
    basins: tuple[int, ...]
    """Starts along each side of a grid."""
    scipy_periods: int
    inner_states: int
    """Samples on bristles."""
    inner_t1: float
    """And their horizon."""


FULL = Sizes(
    samples=40_000,
    vmapped=5_000,
    vmapped_stepped=2_000,
    stepped=1_000,
    stepped_t1=50.0,
    carts=10_000,
    cart_t1=2.0,
    switched_t1=200.0,
    regularized_share=1,
    sensitivity=100_000,
    harmonics=(8, 16, 64),
    sensitivity_compiled=4_096,
    two_blocks=8_192,
    chains=(1, 2, 4, 8, 10, 16, 32, 64, 100, 1000),
    chains_by_numba=(10, 100, 1000),
    chain_blocks=16_384,
    shaken=500,
    blocks_t1=60.0,
    diagrams=(200, 400),
    basins=(150, 300),
    scipy_periods=30,
    inner_states=4096,
    inner_t1=20.0,
)
TINY = Sizes(
    samples=1_000,
    vmapped=10,
    vmapped_stepped=4,
    stepped=16,
    stepped_t1=5.0,
    carts=16,
    cart_t1=0.2,
    switched_t1=5.0,
    regularized_share=1_000,
    sensitivity=1_000,
    harmonics=(2, 2, 2),
    sensitivity_compiled=64,
    two_blocks=64,
    chains=(10,),
    chains_by_numba=(10,),
    chain_blocks=80,
    shaken=8,
    blocks_t1=5.0,
    diagrams=(8,),
    basins=(4,),
    scipy_periods=1,
    inner_states=4,
    inner_t1=1.0,
)
