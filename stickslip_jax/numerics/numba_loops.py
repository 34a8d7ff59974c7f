"""What `loops.compiled` gives: loops that Numba compiles when they are first called."""

from typing import Any, no_type_check

import numba
import numpy as np

_BLOCK = 2048  # sticks: what is between stays in the fastest cache
_WIDTH = 32  # numbers compared at once


def _loop(function: Any) -> Any:
    """Compile `function` on its first call, and keep the machine code for the next process where there is a place."""
    # Sums may be taken in any order: several numbers at a time.
    options = {"nogil": True, "error_model": "numpy", "fastmath": {"reassoc", "nsz", "contract"}}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder to keep it in can be written to
        return numba.njit(**options)(function)


@_loop
@no_type_check
def runs_of(ending, sample, samples, owner, length, place):
    """Owners and lengths of the runs among records, and where the sticks of each lane are to go; how many of both."""
    blocks, lanes = sample.shape
    slots = len(ending) // blocks
    counts = np.zeros((blocks, lanes), np.uint32)
    for block in range(blocks):
        for slot in range(block * slots, (block + 1) * slots):
            for lane in range(lanes):
                counts[block, lane] += ending[slot, lane] >= 0
    runs = sticks = 0
    for lane in range(lanes):
        place[lane] = sticks
        before = np.int64(-1)
        for block in range(blocks):
            whose, count = sample[block, lane], np.int64(counts[block, lane])
            if count > 0 and whose < samples:
                if whose != before:
                    owner[runs], length[runs] = whose, 0
                    runs, before = runs + 1, whose
                length[runs - 1] += count
                sticks += count
    return runs, sticks


@_loop
@no_type_check
def gather(values, ending, sample, samples, place, start, end, position, endings):
    """Put the sticks among records into columns: those of each lane together, from its `place` (lanes,) on."""
    blocks, lanes = sample.shape
    slots = len(ending) // blocks
    found = np.empty(lanes + 1, np.uint32)
    skipped = np.empty(lanes, np.int8)
    one = np.uint64(1)  # Unsigned, for Numba tests whether signed indices are negative.
    for block in range(blocks):
        for lane in range(lanes):
            skipped[lane] = 0 if sample[block, lane] < samples else -1
        for slot in range(block * slots, (block + 1) * slots):
            # No branch depends on whether there is a stick: guessed wrong, it would cost more than all the rest.
            codes, number = ending[slot], np.uint64(0)
            for lane in range(np.uint64(lanes)):
                found[number] = lane
                number += np.uint64((codes[lane] | skipped[lane]) >= 0)
            starts, ends, positions = values[slot, 0], values[slot, 1], values[slot, 2]
            for index in range(number):
                lane = np.uint64(found[index])
                at = place[lane]
                start[at], end[at], position[at] = starts[lane], ends[lane], positions[lane]
                endings[at] = codes[lane]
                place[lane] = at + one


@_loop
@no_type_check
def join(place, length, columns, endings, joined, joined_endings):
    """Copy runs of sticks, (runs,), one after the other."""
    to = np.uint64(0)
    for run in range(len(place)):
        begin = np.uint64(place[run])
        for at in range(begin, begin + np.uint64(length[run])):
            joined[0][to], joined[1][to], joined[2][to] = columns[0][at], columns[1][at], columns[2][at]
            joined_endings[to] = endings[at]
            to += np.uint64(1)


@_loop
@no_type_check
def _fill(start, end, position, begin, before, first, size, run, rows):
    """Start, duration, position, and slip before, of a block of sticks; the next run."""
    # Slices, for Numba tests whether sums of signed indices are negative, and then takes numbers one at a time.
    starts, ends, positions = start[first : first + size], end[first : first + size], position[first : first + size]
    one, two, three, four = rows[0], rows[1], rows[2], rows[3]
    for i in range(len(starts)):
        one[i] = starts[i]
        two[i] = np.float64(ends[i]) - np.float64(starts[i])
        three[i] = positions[i]
    four, starts = four[1:], starts[1:]
    for i in range(len(starts)):
        four[i] = starts[i] - ends[i]
    if first > 0:
        rows[3, 0] = start[first] - end[first - 1]
    while run < len(begin) and begin[run] < first + size:
        rows[3, begin[run] - first] = start[begin[run]] - before[run]
        run += 1
    return run


@_loop
@no_type_check
def _positive(row):
    """The numbers above 0, moved to the front."""
    number = 0
    for i in range(len(row)):
        value = row[i]
        row[number] = value
        number += value > 0
    return row[:number]


@_loop
@no_type_check
def _look(row, a, low, high, total):
    """Update the extremes and the sum of quantity a."""
    # Several of each, for a least number of one row would be found one number at a time.
    ends = np.empty((3, _WIDTH))
    least, most, added = ends[0], ends[1], ends[2]
    for i in range(_WIDTH):
        least[i], most[i], added[i] = low[a], high[a], 0.0
    for first in range(0, len(row), _WIDTH):
        part = row[first : first + _WIDTH]
        for i in range(len(part)):
            value = part[i]
            least[i] = value if value < least[i] else least[i]
            most[i] = value if value > most[i] else most[i]
            added[i] += value
    for i in range(_WIDTH):
        low[a], high[a] = min(low[a], least[i]), max(high[a], most[i])
        total[a] += added[i]


@_loop
@no_type_check
def _count(row, scale, bin_of, place, counts):
    """Count each number x in bin ``floor(x scale) + bin_of`` of `counts`; `place`: without `bin_of`."""
    for i in range(len(row)):
        place[i] = np.int64(np.floor(row[i] * scale))
    for i in range(len(row)):
        counts[np.uint64(place[i] + bin_of)] += 1


@_loop
@no_type_check
def _sum(row, a, mean, scatter, third):
    """Take the mean off, and add squares and cubes of what is left."""
    centre, square, cube = mean[a], 0.0, 0.0
    for i in range(len(row)):
        step = row[i] - centre
        row[i] = step
        square += step * step
        cube += step * step * step
    scatter[a, a] += square
    third[a] += cube


@_loop
@no_type_check
def _product(row, other):
    """Sum of products."""
    total = 0.0
    for i in range(len(row)):
        total += row[i] * other[i]
    return total


@_loop
@no_type_check
def survey(start, end, position, begin, before, all_slips, number, low, high, total):
    """How many starts, durations, positions and slips, their extremes and their sums, (4,).

    Runs begin at `begin`, the slips before them at the times `before`. Only slips above 0 s, unless `all_slips`.
    """
    rows = np.empty((4, _BLOCK))
    run = 0
    for first in range(0, len(start), _BLOCK):
        size = min(_BLOCK, len(start) - first)
        run = _fill(start, end, position, begin, before, first, size, run, rows)
        for a in range(4):
            row = rows[a][:size]
            if a == 3 and not all_slips:
                row = _positive(row)
            _look(row, a, low, high, total)
            number[a] += len(row)


@_loop
@no_type_check
def count(
    start, end, position, begin, before, all_slips, mean, scale, bin_of, shift, pair_bin_of, pairs, counts, scatter,
    third,
):  # fmt: skip
    """Count numbers in bins and sum products and cubes of their deviations from the `mean`.

    Number x of quantity a counts in bin ``floor(x scale[a]) + bin_of[a]`` of `counts`. Bins of pairs are wider by
    ``2**shift[a]`` and begin with `pair_bin_of`; `pairs`, (pairs, 4): x, y, bins of y, first place in `counts`.
    """
    rows, places = np.empty((4, _BLOCK)), np.empty((4, _BLOCK), np.int64)
    run = 0
    for first in range(0, len(start), _BLOCK):
        size = min(_BLOCK, len(start) - first)
        run = _fill(start, end, position, begin, before, first, size, run, rows)
        for a in range(4):
            row, place = rows[a][:size], places[a][:size]
            if a == 3 and not all_slips:
                row = _positive(row)
            _count(row, scale[a], bin_of[a], place, counts)
            _sum(row, a, mean, scatter, third)
            if a < 3:
                bits, offset = shift[a], pair_bin_of[a]
                for i in range(size):
                    place[i] = (place[i] >> bits) - offset
                for b in range(a):
                    scatter[a, b] += _product(row, rows[b][:size])
        for pair in range(len(pairs)):
            x, y, bins, offset = places[pairs[pair, 0]], places[pairs[pair, 1]], pairs[pair, 2], pairs[pair, 3]
            for i in range(size):
                counts[np.uint64(offset + x[i] * bins + y[i])] += 1


@_loop
@no_type_check
def numbered(start, end, position, place, length, order, columns, number):
    """Start, duration and position, (3, orders, samples), of the sticks of each order, and their number, (orders,).

    `order`: of the first stick of each run, (runs,), from 0, negative if it is not numbered.
    """
    most = len(number)
    for run in range(len(place)):
        for inside in range(max(0, -order[run]), min(length[run], most - order[run])):
            at, which = np.uint64(place[run] + inside), np.uint64(order[run] + inside)
            to = np.uint64(number[which])
            columns[0, which, to], columns[2, which, to] = start[at], position[at]
            columns[1, which, to] = np.float64(end[at]) - np.float64(start[at])
            number[which] += 1


@_loop
@no_type_check
def survey_orders(columns, number, low, high, total):
    """Extremes and sums of what `numbered` gave, (orders, 3)."""
    for which in range(len(number)):
        for a in range(3):
            _look(columns[a, which][: number[which]], a, low[which], high[which], total[which])


@_loop
@no_type_check
def count_orders(columns, number, mean, scale, bin_of, bins, counts, scatter, third):
    """Count what `numbered` gave in bins, `bins` (3,) for each order, and sum as `count` does; spoils the columns."""
    place = np.empty(columns.shape[2], np.int64)
    for which in range(len(number)):
        for a in range(3):
            row = columns[a, which][: number[which]]
            _count(row, scale[a], bin_of[a] + which * bins[a], place, counts)
            _sum(row, a, mean[which], scatter[which], third[which])
            for b in range(a):
                scatter[which, a, b] += _product(row, columns[b, which])
