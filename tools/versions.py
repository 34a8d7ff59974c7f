"""Run some tests on other versions of what the package needs: ``python tools/versions.py WHICH ... --tests FILE ...``.

`lowest`: those that pyproject.toml names as lower bounds. `pinned`: those of constraints.txt.
`newest`: whatever pip finds for the newest Python on this machine. Each in an environment of its own in a temporary
folder. A dependency whose newest release has left a Python behind resolves to its last one for that Python. Then the
tests run again with STICKSLIP_PLAIN_JAX=1, which tells a fault of the compiler from one of the package.

`instructions`: the pinned versions once more, for each set of instructions that XLA may use on this processor, by one
thread and by several. Last digits differ between these, and with them what a test must allow.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
EXTRAS = ("study", "cluster", "tables")
TOOLS = ("pytest", "hypothesis", "beartype", "mpmath")
"""What the tests below need besides; at any version."""
INSTRUCTIONS = {"SSE4_2": "sse4_2", "AVX2": "avx2", "AVX512": "avx512f"}
"""As XLA and as the processor call them."""
SHOWN = ("jax", "jaxlib", "numpy", "scipy", "diffrax", "equinox", "jaxtyping", "matplotlib")


def requirements() -> list[str]:
    """Of the package and its extras, those that are tested here."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    return [*project["dependencies"], *(need for extra in EXTRAS for need in extras[extra])]


def lowest(needs: list[str]) -> list[str]:
    """A constraint for each requirement ``name>=version``: that version."""
    found = []
    for need in needs:
        matched = re.fullmatch(r"([A-Za-z0-9._-]+)>=([0-9][0-9.]*)(;.*)?", need)
        if matched is None:
            raise ValueError(f"pyproject.toml requires {need!r}; a requirement must have a lower bound alone")
        found.append(f"{matched[1]}=={matched[2]}{matched[3] or ''}")
    return found


def newest_python() -> str:
    """The newest Python that can be started: on the path, or beside this one where versions have folders."""
    names = [f"python3.{minor}" for minor in range(30, 10, -1)]
    versions = Path(sys.base_prefix).parent
    beside = [path for name in names for path in versions.glob(f"*/bin/{name}")]
    found = [path for name in names if (path := shutil.which(name))] + [str(path) for path in beside]
    able = {path: _version(path) for path in found}
    return max((path for path in able if able[path] >= (3, 11)), key=lambda path: able[path], default=sys.executable)


def _version(python: str) -> tuple[int, ...]:
    code = "import sys; print(*sys.version_info[:3]) if sys.version_info.releaselevel == 'final' else None"
    done = subprocess.run([python, "-c", code], capture_output=True, text=True, check=False)
    return tuple(int(part) for part in done.stdout.split())


def environment(which: str, folder: Path, python: str) -> Path:
    """An environment with those versions; returns its Python."""
    subprocess.run([python, "-m", "venv", str(folder / which)], check=True)
    own = folder / which / ("Scripts" if os.name == "nt" else "bin") / "python"
    command = [str(own), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    if which == "lowest":
        (folder / "lowest.txt").write_text("\n".join(lowest(requirements())) + "\n")
        command += ["-c", str(folder / "lowest.txt")]
    if which in ("pinned", "instructions"):
        command += ["-c", str(ROOT / "constraints.txt")]
    subprocess.run([*command, "-e", f"{ROOT}[{','.join(EXTRAS)}]", *TOOLS], check=True)
    return own


def versions(python: Path) -> str:
    """What is installed, in words."""
    code = (
        "import sys; from importlib.metadata import version; "
        f"print('Python', '.'.join(map(str, sys.version_info[:3])), *(n + ' ' + version(n) for n in {SHOWN}), sep=', ')"
    )
    return subprocess.run([str(python), "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def runs(which: str) -> dict[str, dict[str, str]]:
    """The runs of the tests on one set of versions: a name and environment variables each."""
    if which != "instructions":
        return {which: {"STICKSLIP_PLAIN_JAX": "0"}, f"{which} with plain jax.jit": {"STICKSLIP_PLAIN_JAX": "1"}}
    processor = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    able = [name for name, flag in INSTRUCTIONS.items() if flag in processor]
    flags = {name: f"--xla_cpu_max_isa={name}" for name in able}
    return {name: {"XLA_FLAGS": flag} for name, flag in flags.items()} | {
        f"{name}, one thread": {"XLA_FLAGS": f"{flag} --xla_cpu_multi_thread_eigen=false"}
        for name, flag in flags.items()
    }


def main() -> int:
    """Test on each set of versions; returns how many runs of the tests failed."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument(
        "which", nargs="*", default=[], help="lowest, pinned, newest, instructions; by default all of them"
    )
    options.add_argument("--python", default=sys.executable, help="for the lowest and the pinned versions")
    options.add_argument("--newest-python", default="", help="for the newest versions; by default the newest found")
    options.add_argument("--tests", nargs="+", required=True, help="files of tests")
    chosen = options.parse_args()
    every = ("lowest", "pinned", "newest", "instructions")
    unknown = set(chosen.which) - {*every}
    if unknown:
        options.error(f"unknown versions: {', '.join(sorted(unknown))}")
    failed = []
    for which in chosen.which or every:
        python = (chosen.newest_python or newest_python()) if which == "newest" else chosen.python
        with tempfile.TemporaryDirectory() as folder:
            own = environment(which, Path(folder), python)
            print(f"--- {which}: {versions(own)}", flush=True)
            command = [str(own), "-m", "pytest", "-p", "no:cacheprovider", *chosen.tests]
            for name, variables in runs(which).items():
                print(f"--- {name}", flush=True)
                if subprocess.run(command, cwd=ROOT, env=os.environ | variables, check=False).returncode != 0:
                    failed.append(name)
    print(f"failed: {', '.join(failed)}" if failed else "all passed")
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
