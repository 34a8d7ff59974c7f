"""Every file that results are written to: whole or not there, replaced only when asked, every refusal one sentence."""

import os
import random
import resource
import signal
import stat
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import jax
import pytest

import stickslip_jax as ss
from stickslip_jax import plot

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
WRITERS = {
    "many.nc": lambda many, path, **options: many.save(path, **options),
    "sticks.csv": lambda many, path, **options: many.write_sticks(path, **options),
    "sticks.parquet": lambda many, path, **options: many.write_sticks(path, **options),
    "slips.csv": lambda many, path, **options: many.write_slips(path, **options),
    "slips.parquet": lambda many, path, **options: many.write_slips(path, **options),
    "figure.png": lambda many, path, **options: plot.save(plot.histogram(many), path, **options),
    "figure.pdf": lambda many, path, **options: plot.save(plot.histogram(many), path, **options),
}


def simulated(samples=90):
    law, key = ss.PoissonSwitching(speed=1.0, rate=1.0), jax.random.key(2026)
    return ss.simulate_ensemble(SYSTEM, law, samples=samples, t1=40.0, y0=(0.0, 1.0), key=key, chunk=64, keep="sticks")


@pytest.fixture(scope="module")
def many():
    return simulated()


@contextmanager
def full_disk():
    """As if there were room for 1000 bytes more."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def refused(kind, write):
    with pytest.raises(kind) as caught:
        write()
    message = str(caught.value)
    assert "\n" not in message
    assert message.endswith(".")
    return message


@pytest.mark.parametrize("name", WRITERS)
def test_replaced_only_when_asked(many, tmp_path, name):
    path = tmp_path / name
    WRITERS[name](many, path)
    written = path.read_bytes()
    assert len(written) > 1000
    message = refused(FileExistsError, lambda: WRITERS[name](many, path))
    assert "is there already (" in message
    assert "overwrite=True" in message
    assert path.read_bytes() == written
    path.write_bytes(b"old")
    path.chmod(0o640)
    link = tmp_path / f"link{path.suffix}"
    link.symlink_to(path)
    WRITERS[name](many, link, overwrite=True)
    assert link.is_symlink()
    assert len(path.read_bytes()) > 1000
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert sorted(entry.name for entry in tmp_path.iterdir()) == sorted([name, link.name])


@pytest.mark.parametrize("name", WRITERS)
def test_no_room(many, tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"old")
    with full_disk():
        message = refused(OSError, lambda: WRITERS[name](many, path, overwrite=True))
    assert "cannot be written (File too large); make room: nothing was changed." in message
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == [name]


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize("name", WRITERS)
def test_where_no_file_can_be(many, tmp_path, name):
    write = WRITERS[name]
    message = refused(FileNotFoundError, lambda: write(many, tmp_path / "none" / name))
    assert "must lie in a folder that exists" in message
    folder, fifo = tmp_path / f"folder{Path(name).suffix}", tmp_path / f"fifo{Path(name).suffix}"
    folder.mkdir()
    os.mkfifo(fifo)
    assert "is a folder; choose" in refused(ValueError, lambda: write(many, folder, overwrite=True))
    assert "is a named pipe; choose" in refused(ValueError, lambda: write(many, fifo, overwrite=True))
    assert "must be a file name that ends in ." in refused(ValueError, lambda: write(many, tmp_path / "many.junk"))
    assert "must be a file name, but " in refused(ValueError, lambda: write(many, f"\0{Path(name).suffix}"))
    assert "must be a file name, but 5 was given." in refused(ValueError, lambda: write(many, 5))
    assert "cannot be one" in refused(ValueError, lambda: write(many, f"{300 * 'a'}{Path(name).suffix}"))
    assert "overwrite must be True or False" in refused(ValueError, lambda: write(many, tmp_path / name, overwrite=3))


def test_what_is_there_already_is_told(many, tmp_path):
    path = tmp_path / "many.nc"
    many.save(path)
    assert f", written by stickslip_jax {ss.__version__})" in refused(FileExistsError, lambda: many.save(path))
    path.write_text("mine")
    assert "is there already (a file of 4 bytes)" in refused(FileExistsError, lambda: many.save(path))


def test_tables_have_check_sums(many, tmp_path):
    """Of each page, by which readers that verify them find flipped bits."""
    parquet = pytest.importorskip("pyarrow.parquet")
    path = many.write_sticks(tmp_path / "sticks.parquet")
    data = bytearray(path.read_bytes())
    read = parquet.read_table(path, page_checksum_verification=True).to_pandas()
    assert len(read) == len(many.flat_sticks.start)
    data[len(data) // 3] ^= 1
    path.write_bytes(data)
    with pytest.raises(OSError, match=r"(?i)checksum|crc"):
        parquet.read_table(path, page_checksum_verification=True)


def _write_for_ever(many, folder):
    """Replace all files again and again."""
    while True:
        for name, write in WRITERS.items():
            write(many, folder / name, overwrite=True)


def _killed(folder: Path, kills: int) -> None:
    """Kill processes that replace files at random moments; what is left of each file is whole and the same."""
    many, random_numbers = simulated(), random.Random(1)
    for name, write in WRITERS.items():
        write(many, folder / name)
    replaced = 0
    for _ in range(kills):
        begun = {name: (folder / name).stat().st_ino for name in WRITERS}
        child = os.fork()
        if not child:
            _write_for_ever(many, folder)
        time.sleep(random_numbers.uniform(0.02, 1.0))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        replaced += sum((folder / name).stat().st_ino != inode for name, inode in begun.items())
        back = ss.load(folder / "many.nc")
        assert back.flat_sticks.start.tobytes() == many.flat_sticks.start.tobytes()
        for name in WRITERS:
            left = list(folder.glob(f"{name}.*"))
            assert all(path.suffix == ".unfinished" for path in left)
            for path in left:
                path.unlink()
        assert len((folder / "sticks.csv").read_text().splitlines()) == len(many.flat_sticks.start) + 1
        assert (folder / "figure.pdf").read_bytes().rstrip().endswith(b"%%EOF")
    assert replaced > kills, replaced
    print(f"{kills} kills, {replaced} files replaced")


@pytest.mark.slow
def test_kills(tmp_path):
    """100 kills at random moments while files are replaced."""
    code = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import jax; "
    code += "jax.config.update('jax_enable_x64', True); from pathlib import Path; import test_files; "
    code += f"test_files._killed(Path({str(tmp_path)!r}), 100)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("100 kills")
