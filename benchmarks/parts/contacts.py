"""Several contacts: two blocks and chains beside scalar loops in numba, a chain of ten beside scipy.

Every round times each program once, scipy's in a few of them.
"""

from functools import partial
from typing import Any

from ..baselines import numba_chain, numba_two_blocks, scipy_chain
from ..rounds import Program, Rounds, here
from ..setups import THREADS, chain_name, chain_time, starts
from ..sizes import FULL, TINY
from ..workers import Bench

TWO, LOOP, SCIPY = "two blocks", "numba, scalar: two blocks", "scipy solve_ivp, restarted at events: chain of 10 blocks"
BESIDE = {TWO: LOOP}
FEW = 4  # trajectories by scipy in a round
CALLS = 3  # and in so many rounds


def _yardsticks(tiny: bool) -> list[Program]:
    sizes = TINY if tiny else FULL
    t1 = sizes.blocks_t1

    def loop(number: int, threads: int) -> float:
        numba_two_blocks.given(*starts(number, 2, sizes.two_blocks), t1=t1, threads=threads)
        return sizes.two_blocks * t1

    def chain(number: int, blocks: int, threads: int) -> float:
        samples, until = sizes.chain_blocks // blocks, chain_time(blocks, sizes)
        numba_chain.given(starts(number, blocks, samples), t1=until, threads=threads)
        return samples * until

    def chains(number: int) -> float:
        for x in starts(number, 10, FEW).T:
            scipy_chain.simulate(x, t1=t1)
        return FEW * t1

    loop(0, 1)
    chain(0, min(sizes.chains_by_numba), 1)
    found = [
        Program(f"{LOOP}, {word}", here(lambda number, threads=threads: loop(number, threads)))
        for threads, word in enumerate(THREADS, 1)
    ]
    found += [
        Program(f"{_by_numba(blocks)}, {word}", here(partial(chain, blocks=blocks, threads=threads)))
        for blocks in sizes.chains_by_numba
        for threads, word in enumerate(THREADS, 1)
    ]
    return [*found, Program(f"{SCIPY}, {THREADS[0]}", here(chains), calls=CALLS)]


def _by_numba(blocks: int) -> str:
    return f"numba, scalar: {chain_name(blocks)}"


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each program and number of contacts."""
    worker, sizes = bench.worker(), TINY if bench.tiny else FULL
    lengths, by_numba = sizes.chains, sizes.chains_by_numba
    contacts = {LOOP: 2, TWO: 2, SCIPY: 10} | {_by_numba(blocks): blocks for blocks in by_numba}
    contacts |= {chain_name(blocks): blocks for blocks in lengths}
    beside = BESIDE | {chain_name(blocks): _by_numba(blocks) for blocks in by_numba}
    ours = [f"{name}, {word}" for name in (TWO, *map(chain_name, lengths)) for word in THREADS]
    programs = [*_yardsticks(bench.tiny), *map(worker.program, ours)]
    rounds = Rounds(programs, bench.rounds)
    compiled = {program.label: program.compile_seconds for program in programs}
    rows = []
    for name, number in contacts.items():
        row: dict[str, Any] = {"label": name, "contacts": number, "compile_s": compiled[f"{name}, {THREADS[0]}"]}
        row |= {word: rounds.each(f"{name}, {word}") for word in THREADS if f"{name}, {word}" in compiled}
        if other := beside.get(name):
            row["beside"] = [
                rounds.ratio(f"{name}, {word}", f"{other}, {word}")
                for word in THREADS
                if f"{other}, {word}" in compiled
            ]
        rows.append(row)
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """In microseconds."""
    lines = [
        "| program | contacts | us per simulated second, 1 thread | 2 threads | per contact | times the other program "
        "| compile, s |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        each = [1e6 * row[word] if word in row else None for word in THREADS]
        cells = [row["label"], str(row["contacts"]), *(f"{value:,.2f}" if value else "" for value in each)]
        cells.append(f"{1e6 * row[THREADS[0]] / row['contacts']:,.2f}")
        cells.append(" and ".join(f"{ratio:.2g}" for ratio in row.get("beside", [])))
        cells.append(f"{row['compile_s']:.1f}" if row["compile_s"] > 0.05 else "")
        lines.append(f"| {' | '.join(cells)} |")
    return lines
