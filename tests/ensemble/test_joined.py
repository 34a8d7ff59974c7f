"""More samples of an ensemble, and ensembles joined: the same as one run, or it is said where each part came from."""

import dataclasses

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._ensemble import data

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
KEY = jax.random.key(2026)
RUN = {"t1": 40.0, "y0": (0.0, 1.0), "key": KEY, "orders": 3}
KEEPS = ["sticks", "statistics", "totals"]


def simulate(samples, keep, *, chunk=64, law=POISSON, **changed):
    return ss.simulate_ensemble(SYSTEM, law, samples=samples, keep=keep, chunk=chunk, **{**RUN, **changed})


def compare(one, other, rtol):
    """Sticks, counts and histograms to the last bit; sums within `rtol` of the sum of their terms' sizes."""
    assert (one.samples, one.first_sample, one.status_counts) == (
        other.samples,
        other.first_sample,
        other.status_counts,
    )
    for name in ("flat_sticks", "sample_totals", "retained"):
        for mine, its in zip(jax.tree.leaves(getattr(one, name)), jax.tree.leaves(getattr(other, name)), strict=True):
            np.testing.assert_array_equal(mine, its)
    ours, theirs = (
        {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in jax.tree_util.tree_leaves_with_path(parts)}
        for parts in ((many.moments, many.accumulator) for many in (one, other))
    )
    assert ours.keys() == theirs.keys()
    for name, its in theirs.items():
        if its.dtype.kind in "iu" or rtol == 0:
            np.testing.assert_array_equal(ours[name], its)
            continue
        size = np.max(np.abs(its), initial=0)
        if name.endswith(".third"):  # terms of both signs, whose sizes add up to at least this (Jensen's inequality)
            owner = name.removesuffix("third")
            squares, count = np.diagonal(theirs[owner + "scatter"], axis1=-2, axis2=-1), theirs[owner + "number"]
            size = squares * np.sqrt(squares / np.maximum(count, 1)[..., None])
        np.testing.assert_allclose(ours[name], its, rtol=rtol, atol=rtol * np.max(size, initial=0), err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("keep", KEEPS)
def test_an_extended_ensemble_is_one_longer_run(keep):
    """To the last bit where both are cut at the same samples."""
    longer = simulate(128, keep).extended(samples=60, chunk=64, threads=2)
    compare(longer, simulate(188, keep), 0)
    assert longer.compile_seconds > 0
    if keep != "totals":
        assert repr(longer.summary()) == repr(simulate(188, keep).summary())


@pytest.mark.parametrize("keep", KEEPS)
def test_cut_at_other_samples_only_round_off_differs(keep):
    # Means, squares and cubes are merged from four parts and from three: each merge rounds a few times by 2^-53.
    compare(simulate(100, keep).extended(samples=88, chunk=64), simulate(188, keep), 100 * 2**-53)


@pytest.mark.parametrize("limit", [700, 1500, 10])
def test_the_same_first_samples_are_retained(monkeypatch, limit):
    monkeypatch.setattr(data, "RETAINED", limit)
    longer, whole = simulate(64, "statistics").extended(samples=124, chunk=64), simulate(188, "statistics")
    compare(longer, whole, 0)
    assert len(whole.retained.totals) < 188
    joined = ss.concatenate([simulate(64, "statistics"), simulate(124, "statistics", first_sample=64)])
    compare(joined, whole, 100 * 2**-53)


@pytest.mark.parametrize("keep", KEEPS)
def test_samples_that_follow_each_other_are_joined_to_one_run(keep):
    whole = simulate(188, keep)
    joined = ss.concatenate(
        [simulate(100, keep), simulate(60, keep, first_sample=100), simulate(28, keep, first_sample=160)]
    )
    compare(joined, whole, 100 * 2**-53)
    assert (joined.origins, joined.law, joined.key_data) == ((), POISSON, whole.key_data)
    for number in (0, 99, 100, 187):
        ours, theirs = joined.realization(number), whole.realization(number)
        np.testing.assert_array_equal(ours.base.durations, theirs.base.durations)
    compare(joined.extended(samples=12, chunk=64), simulate(200, keep), 100 * 2**-53)


def test_a_part_knows_its_samples():
    """The first sample of a part is that of the whole with this number."""
    part, whole = simulate(28, "sticks", first_sample=160), simulate(188, "sticks")
    np.testing.assert_array_equal(
        part.flat_sticks.start, whole.flat_sticks.start[whole.flat_sticks.count[:160].sum() :]
    )
    np.testing.assert_array_equal(part.realization(3).base.durations, whole.realization(163).base.durations)
    np.testing.assert_array_equal(part.to_xarray().sample, np.arange(160, 188))
    assert ss.Ensemble.from_xarray(part.to_xarray()).first_sample == 160


@pytest.fixture(scope="module")
def mixed():
    """Two keys, and another law."""
    return [
        simulate(64, "sticks"),
        simulate(20, "sticks", key=jax.random.key(1)),
        simulate(30, "sticks", law=ss.PoissonSwitching(speed=1.0, rate=2.0)),
    ]


def test_parts_of_different_origin(tmp_path, mixed):
    joined = ss.concatenate(mixed)
    assert joined.samples == 114
    assert [origin.samples for origin in joined.origins] == [64, 20, 30]
    assert joined.system == SYSTEM
    assert "differs among the 3 parts" in str(joined.law)
    np.testing.assert_array_equal(joined.flat_sticks.count, np.concatenate([one.flat_sticks.count for one in mixed]))
    time = np.concatenate([one.totals.stick_time for one in mixed])
    assert ss.stick_fraction(joined).value == pytest.approx(time.mean() / 40, rel=1e-13)
    assert ss.stick_fraction(joined).standard_error == pytest.approx(time.std(ddof=1) / 40 / np.sqrt(114), rel=1e-12)
    back = ss.load(joined.save(tmp_path / "joined.nc"))
    for many in (joined, back):
        for number, one, own in ((63, mixed[0], 63), (64, mixed[1], 0), (113, mixed[2], 29)):
            np.testing.assert_array_equal(many.realization(number).base.durations, one.realization(own).base.durations)
    with pytest.raises(ValueError, match="joined from 3 parts of different origin, which cannot be extended"):
        joined.extended(samples=1)
    # Joined ensembles are joined further.
    again = ss.concatenate([back, simulate(20, "sticks", key=jax.random.key(8))])
    assert [origin.samples for origin in again.origins] == [64, 20, 30, 20]


REFUSED = {
    "duration": (lambda: simulate(4, "sticks", t1=10.0), "the same duration t1, but the first has 40.0"),
    "keep": (lambda: simulate(4, "totals"), "the same keep"),
    "numbering": (lambda: simulate(4, "sticks", orders=2), "the same numbering"),
    "samples twice": (lambda: simulate(4, "sticks", first_sample=10), "hold different samples, but two parts"),
    "position": (lambda: ss.Ensemble.from_sticks({"sample": [0], "start": [0.5], "end": [1.0], "position": [1.0]},
                                                  t1=40.0, orders=3, position_unit="mm"), "unit and period of the"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_belong_together_is_refused(mixed, case):
    other, said = REFUSED[case]
    with pytest.raises(ValueError, match=rf"\AArgument ensembles must .*{said}") as caught:
        ss.concatenate([mixed[0], other()])
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_arguments_are_named(mixed):
    for given in ([], mixed[0], [mixed[0], 3]):
        with pytest.raises(ValueError, match="Argument ensembles must be a list of results of simulate_ensemble"):
            ss.concatenate(given)
    for samples in (0, 2.5, 2**31):
        with pytest.raises(ValueError, match="Argument samples must be"):
            mixed[0].extended(samples=samples)
    for first in (-1, 1.5, 2**31):
        with pytest.raises(ValueError, match="Argument first_sample must be"):
            simulate(4, "totals", first_sample=first)


def test_one_ensemble_alone_stays_what_it_is(mixed):
    alone = ss.concatenate(mixed[:1])
    compare(alone, mixed[0], 0)
    assert alone.origins == ()
    assert dataclasses.replace(alone, run_seconds=0.0).realization(5).y0 == mixed[0].realization(5).y0
