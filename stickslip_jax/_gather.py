"""Sticks out of the lanes' records, put in order of sample and time."""

from typing import NamedTuple

import numpy as np

from .events import FlatSticks


class Gathered(NamedTuple):
    """Sticks found in some blocks of records: run after run, each of one sample and in order of time.

    `owner`, `length`: the sample of each run and its number of sticks, (runs,). The others: (sticks,).
    """

    owner: np.ndarray
    length: np.ndarray
    start: np.ndarray
    end: np.ndarray
    position: np.ndarray
    ending: np.ndarray


def sticks_of(values: np.ndarray, ending: np.ndarray, sample: np.ndarray) -> Gathered:
    """The sticks among records.

    `values` (slots, 3, lanes) holds start, end and position, `ending` (slots, lanes) is negative where there is no
    stick, and `sample` (blocks, lanes) tells whose records the lanes of each block of slots hold.
    """
    slots, lanes = ending.shape
    # Lane by lane, so that the sticks of a sample lie together: sorting millions would take longer than simulating.
    # Rows of a power of two, so that shifts do for divisions.
    bits = (slots - 1).bit_length()
    endings = np.full((lanes, 1 << bits), -1, ending.dtype)
    endings[:, :slots] = ending.T
    stuck = endings >= 0
    found = np.flatnonzero(stuck)
    at = (found & ((1 << bits) - 1)) * (3 * lanes)
    at += found >> bits
    start, end, position = (values.reshape(-1)[first * lanes :].take(at) for first in range(3))
    blocks = (ending >= 0).reshape(len(sample), -1, lanes)
    length = np.add.reduce(blocks, axis=1, dtype=np.uint8 if slots < 256 * len(sample) else np.int64).T
    return Gathered(
        sample.T.reshape(-1),
        length.reshape(-1).astype(np.int64),
        start,
        end,
        position,
        endings.reshape(-1).take(found),
    )


def collected(pieces: list[Gathered], finished: np.ndarray) -> FlatSticks:
    """The sticks of all pieces, each sample's pieces being in order of time. Samples not `finished` have no sticks."""
    owner, length, *columns = (np.concatenate(column) for column in zip(*pieces, strict=True))
    first = np.cumsum(length) - length
    # What lanes without a sample did is left out.
    kept = (length > 0) & (owner < len(finished))
    kept[kept] = finished[owner[kept]]
    owner, length, first = owner[kept], length[kept], first[kept]
    order = np.argsort(owner.astype(np.uint16) if len(finished) < 1 << 16 else owner, kind="stable")  # by radix
    length = length[order]
    count = np.bincount(owner[order], weights=length, minlength=len(finished)).astype(np.int64)
    ahead = first[order] - (np.cumsum(length) - length)
    at = np.arange(int(length.sum())) + np.repeat(ahead, length)
    return FlatSticks(count, *(column.take(at) for column in columns))
