"""How long imports take: ``python tools/import_time.py [--rounds N] ["statements" ...]``.

Each program runs in new processes, in turn with ``import jax, jax.numpy``. Printed are medians over the rounds of what
it takes longer than that: the processor's time (user and system), which other programs disturb less, and the time that
passes. All modules have been compiled to bytecode before, as pip does for what it installs; ``--from-source``: Python
compiles this package each time, as it does from a checkout while PYTHONDONTWRITEBYTECODE is set.

For single modules: ``python -X importtime -c "import stickslip_jax"``.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile

JAX = "import jax, jax.numpy"
PROGRAMS = (
    f"{JAX}, equinox",
    f"{JAX}, equinox, diffrax",
    "import stickslip_jax",
    "from stickslip_jax import *",
    "import stickslip_jax, diffrax",
)
MEASURED = """
import resource, time
begin = time.perf_counter()
{}
used = resource.getrusage(resource.RUSAGE_SELF)
print(used.ru_utime + used.ru_stime, time.perf_counter() - begin)
"""


def seconds(program: str, environment: dict[str, str]) -> tuple[float, ...]:
    """Of the processor and of the clock, in a new process."""
    command = [sys.executable, "-c", MEASURED.format(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return tuple(map(float, done.stdout.split()[-2:]))


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("programs", nargs="*", default=PROGRAMS, help="statements of Python")
    options.add_argument("--rounds", type=int, default=11)
    options.add_argument("--from-source", action="store_true")
    chosen = options.parse_args()
    programs = (JAX, *chosen.programs)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    with tempfile.TemporaryDirectory() as folder:
        environment["PYTHONPYCACHEPREFIX"] = folder
        if chosen.from_source:
            seconds(f"{JAX}, equinox, diffrax", environment)
            environment["PYTHONDONTWRITEBYTECODE"] = "1"
        rounds = [[seconds(program, environment) for program in programs] for _ in range(chosen.rounds + 1)][1:]
    width = max(map(len, programs))
    print(f"{'':{width}}  processor, s  clock, s")
    for number, program in enumerate(programs):
        less = [one[0] if number else (0.0, 0.0) for one in rounds]
        longer = [[a - b for a, b in zip(one[number], jax, strict=True)] for one, jax in zip(rounds, less, strict=True)]
        processor, clock = map(statistics.median, zip(*longer, strict=True))
        print(f"{program:{width}} {'+' if number else ' '}{processor:12.3f} {clock:9.3f}")


if __name__ == "__main__":
    main()
