"""Manifests that were edited, that are nested deeply or lack parts, and two of which one is of something else."""

import json
import shutil
from pathlib import Path

import jax
import pytest
from support.faults import assert_same, files_in, one_sentence, run, sweep_of

import stickslip_jax as ss
from stickslip_jax import _cli as cli
from stickslip_jax._sweep import store as store_module
from stickslip_jax._sweep.dataset import status_of, stored_dataset

MANIFESTS = ("manifest.json", "manifest-copy.json")


def rewrite(folder: Path, change) -> None:
    """Change what both manifests say, with a check sum that is right again."""
    for name in MANIFESTS:
        body = json.loads((folder / name).read_text())["body"]
        body = change(body) or body
        (folder / name).write_text(store_module._text(body))


def calls_refused(folder: Path, *parts: str) -> None:
    """Looking, loading and running say what is wrong with a folder."""
    (folder / "sweep.nc").unlink(missing_ok=True)
    for call in (lambda: ss.Sweep.load(folder), lambda: stored_dataset(folder), lambda: status_of(folder)):
        with pytest.raises(ss.SweepError) as error:
            call()
        one_sentence(error, str(folder), *parts)


PARTS = [
    "format_version", "versions", "objects", "deciding", "asked", "dimensions", "floats", "integers", "versions.jax",
    "objects.system", "deciding.t1", "deciding.numbering", "asked.samples", "asked.statistics",
]  # fmt: skip


@pytest.mark.parametrize(
    ("part", "how"),
    [(part, "missing") for part in PARTS] + [(part, "another kind") for part in PARTS if part != "versions.jax"],
)
def test_manifest_with_parts_missing(annotations_unchecked, copied, part, how):
    folder, _ = copied

    def spoil(body):
        *above, last = part.split(".")
        within = body[above[0]] if above else body
        if how == "missing":
            del within[last]
        else:
            within[last] = {"this": "is wrong"} if part != "versions" else "wrong"

    rewrite(folder, spoil)
    if how == "missing" or "." not in part:
        last = part.partition(".")[0] if how != "missing" else part
        calls_refused(folder, "is damaged (its ", "missing", last, "into another folder")
    else:
        calls_refused(folder, "its manifest cannot be used (", "into another folder")


DEEP = 100_000


@pytest.mark.parametrize(
    "text", ["[" * DEEP, '{"body":' * DEEP, '{"body": {"format": ' + "[" * DEEP + "]" * DEEP + "}}"]
)
def test_manifest_that_is_nested_deeply(copied, text):
    folder, _ = copied
    for name in MANIFESTS:
        (folder / name).write_text(text)
    calls_refused(folder, "is damaged (", "into another folder")


def test_manifest_that_is_nested_deeply_and_has_its_check_sum(copied):
    folder, _ = copied

    def deepen(body):
        inner: object = 0
        for _ in range(200):
            inner = {"tuple": [inner]}
        body["objects"]["system"] = inner

    rewrite(folder, deepen)
    calls_refused(folder, "its manifest cannot be used (", "into another folder")


EDITED = {
    "t1": ("deciding", -1.0, "t1"),
    "keep": ("deciding", "junk", "keep"),
    "dtype": ("deciding", "junk", "dtype"),
    "batch": ("deciding", 0, "batch"),
    "independent": ("deciding", 3, "independent"),
    "key_data": ("deciding", [1, -2], "key"),
    "numbering": ("deciding", [10**9, False], "orders"),
    "samples": ("asked", -5, "samples"),
    "realizations": ("asked", 1.5, "realizations"),
    "realizations, as many as fill the memory": ("asked", 10**9, "realizations must be smaller"),
    "statistics": ("asked", "mean_stick_duration", "statistics"),
    "derivatives": ("asked", [["stick_fraction"]], ""),
    "standard_errors": ("asked", {"junk": 0.1}, "standard_error"),
}


@pytest.mark.parametrize("case", EDITED)
def test_edited_manifest(annotations_unchecked, copied, case):
    """What is loaded passes the checks that `Sweep` makes."""
    folder, _ = copied
    part, value, said = EDITED[case]
    name = case.partition(",")[0]
    rewrite(folder, lambda body: body[part].update({name: value}))
    calls_refused(folder, "its manifest cannot be used (", said)


@pytest.mark.parametrize(
    "dimensions",
    [
        [],
        [{"name": "mu", "parameters": ["mu"], "values": []}],
        [{"name": "mu", "parameters": ["mu"], "values": [[0.5, 1.0]]}],
        [{"name": "mu", "parameters": [], "values": [[]]}],
        [{"name": "mu", "parameters": ["mu"], "values": [[0.5], [float("nan")]]}],
        [{"name": "mu", "parameters": ["mu"]}],
        [{"name": "mu", "parameters": ["junk"], "values": [[0.5], [1.0]]}],
        ["mu"],
    ],
)
def test_manifest_with_other_points(copied, dimensions):
    folder, _ = copied
    rewrite(folder, lambda body: body.update(dimensions=dimensions))
    (folder / "sweep.nc").unlink()
    with pytest.raises(ss.SweepError) as error:
        ss.Sweep.load(folder)
    one_sentence(error, f"{folder}: its manifest cannot be used (")


@pytest.mark.parametrize("name", ["system", "law", "y0", "method"])
def test_manifest_with_another_object(annotations_unchecked, copied, name):
    folder, _ = copied
    rewrite(folder, lambda body: body["objects"].update({name: True}))
    with pytest.raises(ss.SweepError) as error:
        ss.Sweep.load(folder)
    one_sentence(error, f"{folder}: its manifest cannot be used (")


def test_statistic_that_is_not_known_is_left_out_alone(copied, capsys, monkeypatch):
    folder, dataset = copied
    rewrite(folder, lambda body: body["asked"]["statistics"].insert(1, "junk"))
    rewrite(folder, lambda body: body["asked"]["derivatives"].append(["junk", ["mu"]]))
    with pytest.warns(UserWarning, match=r"asks for 'junk', which this version .* does not know; it is left out\."):
        found = stored_dataset(folder)
    assert set(found.data_vars) == set(dataset.data_vars)
    assert found.mean_stick_duration.equals(dataset.mean_stick_duration)
    monkeypatch.setattr("stickslip_jax.study._commands.prepare_jax", lambda dtype: None)
    assert cli.main(["show", str(folder)]) == 0
    out, err = capsys.readouterr()
    said = "stickslip: The sweep asks for 'junk', which this version of stickslip_jax does not know; it is left out.\n"
    assert err == 2 * said
    assert out.count("+-") == 10
    with pytest.warns(UserWarning, match="'junk'"):
        sweep = ss.Sweep.load(folder)
    assert_same(run(sweep, folder), dataset)
    assert_same(ss.Sweep.load(folder).results, dataset)  # the manifest does not ask for it any more


# --- two manifests


@pytest.mark.parametrize("wrong", MANIFESTS)
def test_manifest_of_another_sweep_beside_a_good_one(copied, tmp_path, wrong):
    """The batches tell which is right; these stay where they are."""
    folder, dataset = copied
    run(sweep_of(key=jax.random.key(1)), tmp_path / "other")
    shutil.copy(tmp_path / "other" / "manifest.json", folder / wrong)
    before = files_in(folder)
    right = next(name for name in MANIFESTS if name != wrong)
    for call in (lambda: run(sweep_of(), folder), lambda: ss.Sweep.load(folder), lambda: stored_dataset(folder)):
        with pytest.raises(ss.SweepError) as error:
            call()
        one_sentence(
            error, f"{folder / wrong} is of another sweep than {right} and the batches", f"move {wrong} elsewhere"
        )
    assert files_in(folder) == before
    (folder / wrong).unlink()
    assert_same(run(ss.Sweep.load(folder), folder), dataset)


def test_two_manifests_and_no_batches(copied, tmp_path):
    folder, _ = copied
    run(sweep_of(key=jax.random.key(1)), tmp_path / "other")
    shutil.copy(tmp_path / "other" / "manifest.json", folder)
    shutil.rmtree(folder / "batches")
    with pytest.raises(ss.SweepError) as error:
        run(sweep_of(), folder)
    one_sentence(
        error, f"{folder / 'manifest.json'} and manifest-copy.json beside it are of two sweeps", "move the one"
    )


@pytest.mark.parametrize("name", MANIFESTS)
def test_file_of_another_program_beside_a_good_manifest(copied, name):
    """Reading does without it, and nothing replaces it."""
    folder, dataset = copied
    (folder / name).write_text('{"name": "app", "icons": []}')
    (folder / "sweep.nc").unlink()
    before = files_in(folder)
    assert_same(stored_dataset(folder), dataset)
    with pytest.raises(ss.SweepError) as error:
        run(sweep_of(), folder)
    one_sentence(error, f"{folder / name} is a file of another program beside the sweep's own", "move it elsewhere")
    assert files_in(folder) == before
    (folder / name).unlink()
    assert_same(run(sweep_of(), folder), dataset)


def test_manifest_of_another_sweep_alone(copied, tmp_path):
    """All batches are of another sweep than it says: not these are to be moved away."""
    folder, _ = copied
    run(sweep_of(key=jax.random.key(1)), tmp_path / "other")
    for name in MANIFESTS:
        shutil.copy(tmp_path / "other" / name, folder / name)
    with pytest.raises(ss.SweepError) as error:
        run(sweep_of(key=jax.random.key(1)), folder)
    one_sentence(error, f"{folder} has batches of another sweep than its manifest.json", "put their manifest back")


@pytest.mark.parametrize("version", [1, 2])
def test_older_format(copied, version):
    """When a sweep was called a study."""
    folder, _ = copied
    rewrite(folder, lambda body: body.update(format="stickslip_jax study", format_version=version))
    calls_refused(folder, f"it has format {version}, written by stickslip_jax {ss.__version__}", "into another folder")
    with pytest.raises(ss.SweepError, match=f"it has format {version}"):
        run(sweep_of(), folder)
