"""The fastest yardstick: two vectorised C programs (`bangbang.c`), compiled here and called through ctypes.

A mass and spring on a base of velocity `+w` or `-w` that switches at the points of a Poisson process, in
the scales `z = x / a`, `u = x' / (a omega)`, `tau = omega t`. `rate` is `lambda / omega`, `t1` is `omega
t1`.

Statistics: a base interval is a stretch between switches (the last one cut by `t1` counts as one); a stick
is an open interval with `u` equal to the base velocity, ended by release, by a switch or by `t1`, all
counted alike.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from ._common import GivenResult, Totals, check_case, given_arrays, split_samples

PROGRAMS = {"events": 0, "intervals": 1}

_HERE = Path(__file__).parent
_BUILD = _HERE.parent / ".build"
# No libmvec: the polynomials in `vector_math.h` are inlined and cheaper. Without the width flag gcc keeps
# to 256 bits on machines that have 512.
_COMPILE = ["-O3", "-march=native", "-ffast-math", "-fopenmp-simd", "-fPIC"]
_WIDE = ["-mprefer-vector-width=512"]


class _Case(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in ("w", "mean_gap", "horizon", "z0", "u0")]
    _fields_ += [("sign", ctypes.c_int)]


class _Totals(ctypes.Structure):
    _fields_ = [("samples", ctypes.c_int64)]
    _fields_ += [
        (name, ctypes.c_double)
        for name in ("intervals", "sticks", "stick_time", "sticks_squared", "stick_time_squared")
    ]


class _Given(ctypes.Structure):
    _fields_ = [
        (name, ctypes.POINTER(ctypes.c_double))
        for name in ("z0", "u0", "sign", "gaps", "intervals", "sticks", "stick_time", "z", "u")
    ]


def _run(command: list[str]) -> None:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr}")


def _compile(target: Path) -> None:
    """Compiles `bangbang.c` into the shared library `target`."""
    compiler = os.environ.get("CC", "cc")
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        item, library = Path(folder) / "bangbang.o", Path(folder) / target.name
        source = [str(_HERE / "bangbang.c"), "-o", str(item)]
        try:
            _run([compiler, "-c", *_COMPILE, *_WIDE, *source])
        except RuntimeError:  # a compiler for another machine does not know the width flag
            _run([compiler, "-c", *_COMPILE, *source])
        # Linked apart and without -ffast-math: with it, gcc before 13 adds start-up code to the library
        # that switches denormal numbers off in the whole Python process.
        _run([compiler, "-shared", str(item), "-o", str(library), "-lm"])
        library.replace(target)


def _machine() -> bytes:
    """What `-march=native` depends on: a library built on another kind of machine must not be used here."""
    try:
        lines = Path("/proc/cpuinfo").read_bytes().splitlines()
    except OSError:
        return platform.processor().encode()
    features = [line for line in lines if line.startswith((b"flags", b"Features"))]
    return features[0] if features else platform.processor().encode()


@functools.cache
def library() -> ctypes.CDLL:
    """The compiled library; built once for each content of the sources, then kept in `benchmarks/.build`."""
    content = [(_HERE / name).read_bytes() for name in ("bangbang.c", "vector_math.h", "c_yardstick.py")]
    _BUILD.mkdir(exist_ok=True)
    (_BUILD / ".gitignore").write_text("*\n")
    key = hashlib.sha256(b"".join([*content, _machine(), os.environ.get("CC", "").encode()])).hexdigest()[:16]
    target = _BUILD / f"bangbang-{key}.so"
    if not target.exists():
        _compile(target)
    lib = ctypes.CDLL(str(target))
    lib.bangbang_run.argtypes = [
        ctypes.c_int,
        ctypes.POINTER(_Case),
        ctypes.c_uint64,
        ctypes.c_int64,
        ctypes.c_int64,
        ctypes.POINTER(_Totals),
    ]
    lib.bangbang_given.argtypes = [
        ctypes.c_int,
        ctypes.c_double,
        ctypes.c_double,
        ctypes.c_int64,
        ctypes.c_int64,
        ctypes.POINTER(_Given),
    ]
    lib.math_probe.argtypes = [ctypes.c_int64] + [ctypes.POINTER(ctypes.c_double)] * 4
    for function in (lib.bangbang_run, lib.bangbang_given, lib.math_probe):
        function.restype = None
    return lib


def _pointer(array: np.ndarray):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def _program(name: str) -> int:
    if name not in PROGRAMS:
        raise ValueError(f"program must be one of {sorted(PROGRAMS)}, got {name!r}")
    return PROGRAMS[name]


def _part(program: int, case: _Case, seed: int, samples: int, chain: int) -> list[float]:
    totals = _Totals()
    library().bangbang_run(program, ctypes.byref(case), seed, samples, chain, ctypes.byref(totals))
    return [getattr(totals, field[0]) for field in _Totals._fields_]


def simulate(
    program,
    *,
    w,
    rate,
    t1,
    samples,
    y0=(0.0, 0.0),
    seed=0,
    initial_sign=0,
    threads=1,
    chain=0,
) -> Totals:
    """Statistics of `samples` trajectories on a Poisson-switching base.

    Args:
        program: `"events"` (a step of the lanes per event) or `"intervals"` (a step per base interval).
        w, rate, t1: `v0 / (a omega)`, `lambda / omega`, `omega t1`.
        y0: `(z0, u0)` in the fixed frame.
        initial_sign: first sign of the base velocity, +1 or -1, or 0 for a fair coin.
        threads: size of the thread pool; each thread has its own stream of random bits.
        chain: largest number of trajectories that a lane runs one after the other before its block ends. 0:
            no limit, the fastest. 1: a block lasts until the slowest of its lanes has ended one trajectory.
    """
    check_case(w, t1, rate, initial_sign)
    case = _Case(w, 1.0 / rate, t1, *y0, initial_sign)
    parts = split_samples(samples, threads)
    seeds = [int(word) for word in np.random.SeedSequence(seed).generate_state(len(parts), np.uint64)]
    number = _program(program)
    library()  # compiled before the threads start, which might all try
    if threads == 1:
        sums = _part(number, case, seeds[0], samples, chain)
    else:
        with ThreadPoolExecutor(threads) as pool:
            work = [pool.submit(_part, number, case, *both, chain) for both in zip(seeds, parts, strict=True)]
            sums = np.sum([item.result() for item in work], axis=0)
    return Totals(*(int(value) for value in sums[:3]), *(float(value) for value in sums[3:]))


def given_gaps(program, *, w, t1, gaps, y0=(0.0, 0.0), initial_sign=1) -> GivenResult:
    """The same step functions on given gaps, one row of `gaps` per trajectory.

    The base switches after each gap; after the last it keeps its velocity until `t1`; gaps beyond `t1` are
    not used. `z0`, `u0` and `initial_sign` are numbers or one value per trajectory.
    """
    check_case(w, t1)
    gaps, z0, u0, sign = given_arrays(gaps, y0, initial_sign)
    results = [np.empty(len(gaps)) for _ in range(5)]
    given = _Given(*(_pointer(array) for array in (z0, u0, sign, gaps, *results)))
    library().bangbang_given(_program(program), w, t1, *gaps.shape, ctypes.byref(given))
    intervals, sticks = (array.astype(int) for array in results[:2])
    return GivenResult(intervals, sticks, *results[2:])


def probe_math(x) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For tests: the library's `sin x`, `cos x`, and the angle in `[0, 2 pi)` of `(cos x, sin x)`."""
    x = np.ascontiguousarray(x, dtype=float)
    sine, cosine, angle = (np.empty_like(x) for _ in range(3))
    library().math_probe(x.size, *(_pointer(array) for array in (x, sine, cosine, angle)))
    return sine, cosine, angle
