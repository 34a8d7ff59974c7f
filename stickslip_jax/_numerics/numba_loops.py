"""The loops that `loops.compiled` returns."""

from typing import Any, no_type_check

import numpy as np

try:
    import numba
except ImportError:  # Numba supports a new Python some months after its release
    numba = None

_BLOCK = 2048  # sticks: intermediate results stay in the fastest cache
_WIDTH = 32  # numbers compared at once


def _loop(function: Any) -> Any:
    """Compile `function` on its first call, and keep the machine code for other processes where possible."""
    if numba is None:
        return function
    # Sums may be taken in any order: several numbers at a time.
    options = {"nogil": True, "error_model": "numpy", "fastmath": {"reassoc", "nsz", "contract"}}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no cache folder is writable
        return numba.njit(**options)(function)


@_loop
@no_type_check
def gather(
    values, ending, sample, samples, begin_at, whose, so_far, last, count, finish, numbers, slip, endings, owner, order
):  # fmt: skip
    """Put the sticks among records into columns from `begin_at` on, and return where the columns end then.

    `whose`, `so_far`, `last`, (lanes,): the sample that each lane is in, its sticks so far, and the end of the last;
    `count`, `finish`, (samples,): the same of each sample.
    """
    blocks, lanes = sample.shape
    slots = len(ending) // blocks
    found = np.empty(lanes + 1, np.uint32)
    skipped = np.empty(lanes, np.int8)
    one, at = np.uint64(1), np.uint64(begin_at)  # unsigned: Numba tests whether signed indices are negative
    start, end, position, further = numbers[0], numbers[1], numbers[2], numbers[3:]
    for block in range(blocks):
        for lane in range(lanes):
            of_lane = sample[block, lane]
            skipped[lane] = 0 if of_lane < samples else -1
            if of_lane != whose[lane]:
                whose[lane], so_far[lane], last[lane] = of_lane, 0, 0
        for slot in range(block * slots, (block + 1) * slots):
            # No branch depends on whether there is a stick: its mispredictions would cost more than all the rest.
            codes, number = ending[slot], np.uint64(0)
            for lane in range(np.uint64(lanes)):
                found[number] = lane
                number += np.uint64((codes[lane] | skipped[lane]) >= 0)
            starts, ends, positions = values[slot, 0], values[slot, 1], values[slot, 2]
            for index in range(number):
                lane = np.uint64(found[index])
                begin, finished, before = starts[lane], ends[lane], so_far[lane]
                start[at], end[at], position[at], slip[at] = begin, finished, positions[lane], begin - last[lane]
                endings[at], owner[at], order[at] = codes[lane], whose[lane], before
                so_far[lane], last[lane] = before + 1, finished
                for row in range(len(further)):
                    further[row, at] = values[slot, 3 + row, lane]
                at += one
        for lane in range(lanes):
            if skipped[lane] == 0:
                count[whose[lane]], finish[whose[lane]] = so_far[lane], last[lane]
    return at


@_loop
@no_type_check
def put_in_order(first, owner, order, columns, ending, ordered, endings):
    """Put each stick where the sticks of its sample begin, `first` (samples,), plus its `order` among them.

    `columns`, `ending`: of the sticks; `ordered`, `endings`: where they are put. Tuples of columns, because the rows of
    a part of a larger array are contiguous, and it is not.
    """
    for i in range(len(owner)):
        at = np.uint64(first[np.uint64(owner[i])] + order[i])
        endings[at] = ending[i]
        for row in range(len(columns)):
            ordered[row][at] = columns[row][i]


@_loop
@no_type_check
def rest_times(start, end, owner, times):
    """How long each sample rests from t = 0 on, (samples,)."""
    for i in range(len(start)):
        if start[i] == 0:
            times[np.uint64(owner[i])] = end[i]


@_loop
@no_type_check
def count_endings(start, ending, skip_rest, number):
    """How many sticks end how, (endings,). `skip_rest`: whether to leave out the sticks that begin at 0."""
    for code in range(len(number)):
        found = 0
        for i in range(len(start)):
            found += (ending[i] == code) & ((start[i] != 0) | (not skip_rest))
        number[code] = found


@_loop
@no_type_check
def _fill(start, end, position, slip, others, skip_rest, first, size, rows):
    """Start, duration, position, `others` and preceding slip of each stick of a block; returns their number.

    They are written into `rows`, one for each quantity. `skip_rest`: whether to leave out the sticks that begin at 0.
    """
    # Slices: Numba tests whether sums of signed indices are negative, and does not vectorise then.
    starts, ends, positions = start[first : first + size], end[first : first + size], position[first : first + size]
    slips, one, two, three, last = slip[first : first + size], rows[0], rows[1], rows[2], rows[len(rows) - 1]
    if not skip_rest:
        for i in range(len(starts)):
            one[i], three[i], last[i] = starts[i], positions[i], slips[i]
            two[i] = np.float64(ends[i]) - np.float64(starts[i])
        for a in range(len(others)):
            rows[3 + a][:size] = others[a][first : first + size]
        return size
    # Every stick is written, and the next one over it if it is left out: no branch that could be predicted wrongly.
    number = np.uint64(0)
    for i in range(len(starts)):
        one[number], three[number], last[number] = starts[i], positions[i], slips[i]
        two[number] = np.float64(ends[i]) - np.float64(starts[i])
        for a in range(len(others)):
            rows[3 + a, number] = others[a, first + i]
        number += np.uint64(starts[i] != 0)
    return np.int64(number)


@_loop
@no_type_check
def _positive(row):
    """The numbers above 0, moved to the front."""
    number = 0  # without a branch, as in `_fill`
    for i in range(len(row)):
        value = row[i]
        row[number] = value
        number += value > 0
    return row[:number]


@_loop
@no_type_check
def _look(row, a, low, high, total):
    """Update the extremes and the sum of quantity a."""
    # Several extremes and sums side by side: a single one would not be vectorised.
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
    # The first loop is vectorised; the second, which writes to places that only the numbers tell, cannot be.
    for i in range(len(row)):
        place[i] = np.int64(np.floor(row[i] * scale))
    for i in range(len(row)):
        counts[np.uint64(place[i] + bin_of)] += 1


@_loop
@no_type_check
def _sum(row, a, mean, scatter, third):
    """Subtract the mean, and add squares and cubes of the deviations."""
    # In place, because products with other quantities are of deviations too. Sums of deviations from the mean, which an
    # earlier pass found, lose no digits where the mean is large compared with the spread.
    center, square, cube = mean[a], 0.0, 0.0
    for i in range(len(row)):
        step = row[i] - center
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
def survey(start, end, position, slip, others, skip_rest, all_slips, number, low, high, total):
    """How many starts, durations, positions, `others` (quantities, sticks) and slips, their extremes and their sums.

    Each of the results has one entry for each quantity. Without the sticks that begin at 0 if `skip_rest`; only slips
    above 0 s, unless `all_slips`.
    """
    # Bins need the range of the numbers, deviations their mean: so this pass comes before `count`.
    d = len(number)
    rows = np.empty((d, _BLOCK))
    for first in range(0, len(start), _BLOCK):
        size = min(_BLOCK, len(start) - first)
        size = _fill(start, end, position, slip, others, skip_rest, first, size, rows)
        for a in range(d):
            row = rows[a][:size]
            if a == d - 1 and not all_slips:
                row = _positive(row)
            _look(row, a, low, high, total)
            number[a] += len(row)


@_loop
@no_type_check
def count(
    start, end, position, slip, others, skip_rest, all_slips, mean, scale, bin_of, shift, pair_bin_of, pairs, counts,
    scatter, third,
):  # fmt: skip
    """Count numbers in bins and sum products and cubes of their deviations from the `mean`.

    Number x of quantity a counts in bin ``floor(x scale[a]) + bin_of[a]`` of `counts`. Bins of pairs are wider by
    ``2**shift[a]`` and begin with `pair_bin_of`; `pairs`, (pairs, 4): x, y, bins of y, first place in `counts`.
    """
    d = len(mean)
    rows, places = np.empty((d, _BLOCK)), np.empty((d, _BLOCK), np.int64)
    for first in range(0, len(start), _BLOCK):
        size = min(_BLOCK, len(start) - first)
        size = _fill(start, end, position, slip, others, skip_rest, first, size, rows)
        for a in range(d):
            row, place = rows[a][:size], places[a][:size]
            if a == d - 1 and not all_slips:
                row = _positive(row)
            _count(row, scale[a], bin_of[a], place, counts)
            _sum(row, a, mean, scatter, third)
            if a < d - 1:  # not slips, which are in no pair
                # A wide bin of pairs is 2**bits bins of the single quantity.
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
def numbered(start, end, position, others, owner, order, skipped, columns, number, earlier, first_two):
    """Start, duration, position and `others` of the sticks of each order, and their `number`, (orders,).

    `columns`: (quantities, orders, sticks).

    Also the durations of the first and the second stick of each sample that has both, (2, samples).
    `earlier`: scratch array. `skipped`: how many sticks of each sample have no number, (samples,).
    """
    most = len(number)
    # Sticks of one sample come in order of time, so that its first stick is always seen before its second.
    for i in range(len(start)):
        whose = np.uint64(owner[i])
        which = order[i] - skipped[whose]
        if 0 <= which < most:
            duration = np.float64(end[i]) - np.float64(start[i])
            to = np.uint64(number[which])
            columns[0, which, to], columns[1, which, to], columns[2, which, to] = start[i], duration, position[i]
            for a in range(len(others)):
                columns[3 + a, which, to] = others[a, i]
            number[which] += 1
            if which == 0:
                earlier[whose] = duration
            elif which == 1:
                first_two[0, to], first_two[1, to] = earlier[whose], duration


def by_order(of_sticks: Any, skipped: Any, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `numbered` finds of the first `most` sticks of each sample: columns, numbers, durations of the first two.

    `of_sticks`: the first six arguments of `numbered`.
    """
    samples = len(skipped)
    columns, found = np.empty((3 + len(of_sticks[3]), most, samples)), np.zeros(most, np.int64)
    earlier, pair = np.empty(samples), np.empty((2, samples))
    numbered(*of_sticks, skipped, columns, found, earlier, pair)
    return columns, found, pair[:, : found[1]]


@_loop
@no_type_check
def survey_orders(columns, number, low, high, total):
    """Extremes and sums of what `numbered` gave, (orders, quantities)."""
    for which in range(len(number)):
        for a in range(len(columns)):
            _look(columns[a, which][: number[which]], a, low[which], high[which], total[which])


@_loop
@no_type_check
def count_orders(columns, number, mean, scale, bin_of, bins, counts, scatter, third):
    """Count what `numbered` gave in bins, and sum as `count` does; spoils the columns.

    `bins`: how many each order has of each quantity, (quantities,).
    """
    place = np.empty(columns.shape[2], np.int64)
    for which in range(len(number)):
        for a in range(len(columns)):
            row = columns[a, which][: number[which]]
            _count(row, scale[a], bin_of[a] + which * bins[a], place, counts)
            _sum(row, a, mean[which], scatter[which], third[which])
            for b in range(a):
                scatter[which, a, b] += _product(row, columns[b, which])
