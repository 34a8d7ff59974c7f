"""Test the wheel as a user installs it, without extras: ``python tools/plain_wheel.py``.

The wheel is built and installed into a new environment in a temporary folder, with its plain dependencies in the
versions of constraints.txt and nothing else; there `plain_package.py` runs.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main() -> int:
    """Returns the exit code of the test."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
        own = folder / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"
        pip = [str(own), "-m", "pip", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", name, str(ROOT)], check=True)
        (wheel,) = folder.glob("*.whl")
        install = [*pip, "install", str(wheel)]
        # Where a pinned version has no build for this Python, the lower bounds of pyproject.toml decide.
        if subprocess.run([*install, "-c", str(ROOT / "constraints.txt")], check=False).returncode != 0:
            subprocess.run(install, check=True)
        command = [str(own), "-I", str(ROOT / "tools" / "plain_package.py")]
        return subprocess.run(command, cwd=name, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
