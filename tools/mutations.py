"""Switch each guard of the package off in turn, and see a test fail: ``python tools/mutations.py [WORD ...]``.

Works on a copy of the package and its tests in a temporary folder. Each line of `GUARDS` is one guard: what it holds,
its file, the code that does it, code that does not, and the tests that must notice. With words, only guards whose
sentence has one of them. Ends with an error if the code of a guard is not found once (it has moved: mend the line
here), if its tests fail without the change, or if they pass with it.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
FAILED = 1  # what pytest returns where tests fail
COPIED = ("stickslip_jax", "tests", "pyproject.toml", "README.md", "docs", "CITATION.cff")


class Guard(NamedTuple):
    """A guard, and what must notice that it is off."""

    holds: str
    file: str
    code: str
    off: str
    tests: str


PROGRAMS, KEPT = "_compiler/programs.py", "tests/compiler/test_kept_programs.py"
LOADED = "tests/compiler/test_loaded_programs.py"
ENGINE = "_dynamics/switched/engine.py"
GUARDS = (
    Guard(
        "a kept program whose bits have changed is not run",
        PROGRAMS, "if hashlib.sha256(data[32:]).digest() != data[:32]:", "if len(data) < 32:",
        f"{KEPT}::test_a_program_that_is_not_of_its_sum_is_not_run",
    ),
    Guard(
        "a folder of programs that others may write is not used",
        PROGRAMS, "return folder if is_own else None", "return folder",
        f"{KEPT}::test_a_folder_that_others_may_write_or_read_is_refused",
    ),
    Guard(
        "what JAX has from its own cache is not written again",
        PROGRAMS, "if _hits() == before and all(", "if all(",
        f"{KEPT}::test_what_jax_has_from_its_own_cache_is_not_kept",
    ),
    Guard(
        "options of JAX are part of what identifies a program",
        PROGRAMS, "about = (this_machine(), options_now(), ", "about = (this_machine(), ",
        KEPT,
    ),
    Guard(
        "programs that call functions from elsewhere are not kept",
        PROGRAMS, "all(name.startswith(_EVERYWHERE) for name in calls)", "True",
        f"{LOADED}::test_a_program_that_calls_a_function_from_elsewhere_is_not_kept",
    ),
    Guard(
        "programs that call LAPACK find it",
        PROGRAMS, "if needs_lapack:", "if not needs_lapack:",
        f"{LOADED}::test_a_program_that_calls_lapack_finds_it",
    ),
    Guard(
        "programs are let go of before memory maps run out",
        PROGRAMS, "                _let_go_of_too_many()\n", "",
        f"{KEPT}::test_programs_go_where_memory_maps_run_out",
    ),
    Guard(
        "slips on the device begin anew with each sample",
        "_numerics/device_loops.py", "jnp.where(order > 0, start - end_at(earlier), start)", "start - end_at(earlier)",
        "tests/ensemble/test_many_lanes.py::test_sums_and_sticks_are_those_of_the_loops",
    ),
    Guard(
        "a state that is no number ends a trajectory",
        ENGINE, "& ~again, jnp.nan, y[0])", "& ~again, y[0], y[0])",
        "tests/excitation/test_own_laws.py::test_a_base_without_a_value_is_reported",
    ),
    Guard(
        "events that round-off decides are counted, in time steps",
        ENGINE, "near_grazing = tie | (tie_if_abrupt & abrupt) | is_tie(margin) | vanished", "near_grazing = vanished",
        "tests/dynamics/switched/test_ties.py",
    ),
    Guard(
        "events of a slow motion are not taken for tangents",
        ENGINE, "(trial.d1 * (trial.d1 / trial.scale) * h < 2 * few * bend) & ", "",
        "tests/dynamics/switched/test_corners.py::test_an_overdamped_valve_is_not_near_grazing",
    ),
    Guard(
        "events that round-off decides are counted, in closed form",
        "_dynamics/interval/arcs.py",
        "scales, began, duration, velocity = lax.stop_gradient((scales, began, duration, velocity))",
        "return jnp.zeros_like(began.t, bool)",
        "tests/dynamics/interval/test_ties.py",
    ),
    Guard(
        "a stick without length is none",
        ENGINE, "(lane.t > lane.stick_start + lane.start_error)\n", "(lane.t >= lane.stick_start)\n",
        "tests/dynamics/switched/test_lattice.py",
    ),
    Guard(
        "a kink of friction has the slope of the side on which the mass slips",
        ENGINE, "    if model.has_kinks:\n", "    if False:\n",
        "tests/simulation/test_higher_derivatives.py::test_a_last_step_that_ends_on_a_kink_has_the_slopes_of_this_side",
    ),
    Guard(
        "steps that are too long are refused",
        "_dynamics/common/method.py", "if given > longest * (1 + 1e-9):", "if False:",
        "tests/dynamics/switched/test_bad_input.py",
    ),
    Guard(
        "a record that ends before the simulation is refused",
        "_dynamics/common/method.py", "if motion.covered_time < float(self.t1) * (1 - 1e-12):", "if False:",
        "tests/dynamics/switched/test_bad_input.py",
    ),
    Guard(
        "a force at resonance without damping is refused",
        "_systems/mass_spring.py", "< _RESONANCE * values_of(omega)):", "< 0):",
        "tests/dynamics/switched/test_bad_input.py",
    ),
    Guard(
        "masked entries are refused",
        "_foundation/checks.py", "(*_NO_NUMBERS, type)) or np.ma.is_masked(value):", "(*_NO_NUMBERS, type)):",
        "tests/package/test_strange_values.py",
    ),
    Guard(
        "a fork of a process in which JAX runs is told",
        "_foundation/checks.py", "    if _State.lost:\n", "    if False:\n",
        "tests/package/test_forks.py::test_a_fork_after_jax_has_started_is_told",
    ),
    Guard(
        "samples that did not finish are in no statistic",
        "_ensemble/data.py", "for column in columns], axis=1)[finished]", "for column in columns], axis=1)",
        "tests/ensemble/test_ensemble.py::test_samples_that_end_early_are_counted_apart_and_enter_nothing",
    ),
    Guard(
        "batches of a sweep whose bits have changed are done again",
        "_ensemble/encoding.py", "if stated != hashlib.sha256(found + rest).digest():", "if False:",
        "tests/sweep/test_headers.py",
    ),
    Guard(
        "a client that is closed between the check and a task is told",
        "_sweep/run.py", "            self.check()\n            raise\n", "            raise\n",
        "tests/sweep/test_clusters.py::test_client_closed_between_the_check_and_a_task_is_told",
    ),
    Guard(
        "sticks in a file last for its stick times",
        "_ensemble/conversions.py", "slack)[finished]), ", "slack)[finished]) or True, ",
        "tests/ensemble/test_stored_edits.py",
    ),
    Guard(
        "much memory for every stick is told before it is taken",
        "_ensemble/data.py", "if len(kept) == 1 and expected > _MUCH:", "if False:",
        "tests/ensemble/test_ensemble.py::test_much_memory_is_told_before_it_is_taken",
    ),
    Guard(
        "memory for every stick that is not there is refused",
        "_ensemble/data.py", "    if expected > there:\n", "    if False:\n",
        "tests/ensemble/test_ensemble.py::test_much_memory_is_told_before_it_is_taken",
    ),
)  # fmt: skip


def outcome(copy: Path, tests: str) -> tuple[int, str]:
    """What pytest returns for these tests in the copy, and the end of what it prints."""
    environment = os.environ | {"PYTHONPATH": str(copy), "MPLBACKEND": "Agg"}
    command = f"{sys.executable} -m pytest -q -x -n 0 -p no:cacheprovider -m 'not browser and not documents' {tests}"
    done = subprocess.run(
        command, shell=True, cwd=copy, env=environment, capture_output=True, text=True, timeout=1800, check=False
    )
    return done.returncode, done.stdout[-600:]


def main() -> None:
    """Raises SystemExit where a guard is not guarded."""
    guards = [one for one in GUARDS if not sys.argv[1:] or any(word in one.holds for word in sys.argv[1:])]
    amiss = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in COPIED:
            whole = ROOT / name
            (shutil.copytree if whole.is_dir() else shutil.copy)(whole, copy / name)
        for guard in guards:
            path = copy / "stickslip_jax" / guard.file
            written = path.read_text(encoding="utf-8")
            if written.count(guard.code) != 1:
                amiss.append(f"{guard.holds}: its code is in {guard.file} {written.count(guard.code)} times")
                continue
            usual, told = outcome(copy, guard.tests)
            if usual:
                amiss.append(f"{guard.holds}: {guard.tests} fail without a change\n{told}")
                continue
            path.write_text(written.replace(guard.code, guard.off), encoding="utf-8")
            status, told = outcome(copy, guard.tests)
            path.write_text(written, encoding="utf-8")
            noticed = status == FAILED
            print("noticed:" if noticed else f"NOT NOTICED ({status}):", guard.holds, flush=True)
            if not noticed:
                amiss.append(f"{guard.holds}: {guard.tests}\n{told}")
    if amiss:
        sys.exit("\n".join(amiss))


if __name__ == "__main__":
    main()
