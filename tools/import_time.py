"""How long imports take: ``python tools/import_time.py [--rounds N] ["statements" ...]``.

Each program runs in new processes, in turn with ``import jax, jax.numpy``. Printed are medians over the rounds of what it
takes longer than that: the processor's time (user and system), which other programs disturb less, and the time that
passes. For single modules: ``python -X importtime -c "import stickslip_jax"``.
"""

import argparse
import statistics
import subprocess
import sys

JAX = "import jax, jax.numpy"
PROGRAMS = (
    f"{JAX}, equinox",
    f"{JAX}, equinox, diffrax",
    "import stickslip_jax",
    "import stickslip_jax, diffrax",
)
MEASURED = """
import resource, time
begin = time.perf_counter()
{}
used = resource.getrusage(resource.RUSAGE_SELF)
print(used.ru_utime + used.ru_stime, time.perf_counter() - begin)
"""


def seconds(program: str) -> tuple[float, ...]:
    """Of the processor and of the clock, in a new process."""
    command = [sys.executable, "-c", MEASURED.format(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return tuple(map(float, done.stdout.split()[-2:]))


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("programs", nargs="*", default=PROGRAMS, help="statements of Python")
    options.add_argument("--rounds", type=int, default=11)
    chosen = options.parse_args()
    programs = (JAX, *chosen.programs)
    rounds = [[seconds(program) for program in programs] for _ in range(chosen.rounds + 1)][1:]  # without the cold one
    print(f"{'':40} processor, s  clock, s")
    for number, program in enumerate(programs):
        less = 0 if number else None
        cpu, clock = (
            statistics.median(one[number][kind] - (0 if less is None else one[less][kind]) for one in rounds)
            for kind in (0, 1)
        )
        print(f"{program if number == 0 else f'{program}: longer by':55} {cpu:6.3f} {clock:6.3f}")


if __name__ == "__main__":
    main()
