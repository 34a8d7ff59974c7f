"""Ensembles whose system, law and start differ from sample to sample."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats as st

import stickslip_jax as ss
from stickslip_jax._uncertainty.inputs import Input

KEY = jax.random.key(7)
LAW = ss.PoissonSwitching(1.0, 2.0)
TONE = ss.RandomPhase(ss.Harmonic(1.0, 3.0))
T1, SAMPLES = 10.0, 300
ULPS = 16 * np.finfo(float).eps * T1  # an event time is a sum of a few dozen numbers below t1


def oscillator(mu=0.5, stiffness=100.0, mu_static=None):
    return ss.MassSpring(mass=1.0, stiffness=stiffness, normal_force=20.0, friction=ss.Coulomb(mu, mu_static))


def run(system=None, law=LAW, **changed):
    arguments = {"t1": T1, "samples": SAMPLES, "key": KEY, "keep": "sticks"} | changed
    return ss.simulate_ensemble(oscillator() if system is None else system, law, **arguments)


def sticks_of(many, number):
    mask = np.asarray(many.sticks.mask[number])
    return np.stack([np.asarray(getattr(many.sticks, name)[number])[mask] for name in ("start", "end", "position")])


@pytest.fixture(scope="module")
def uncertain():
    system = oscillator(ss.Uniform(0.2, 1.0), ss.LogNormal(100.0, 0.2))
    return run(system, y0=(ss.Normal(0.0, 0.05), 0.1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "method", "samples"),
    [
        (LAW, ss.Exact(), 300),
        (TONE, ss.Exact(), 24),
        pytest.param(TONE, ss.Regularized(1e-2, step=1e-2), 24, marks=pytest.mark.slow),
    ],
    ids=["intervals", "steps", "regularized"],
)
def test_samples_are_those_of_the_ensemble_with_that_number(law, method, samples):
    mus = np.resize([0.3, 0.5, 0.8], samples)
    many = run(oscillator(mus), law, samples=samples, method=method)
    for mu in np.unique(mus):
        plain = run(oscillator(float(mu)), law, samples=samples, method=method)
        for number in np.flatnonzero(mus == mu):
            mine, theirs = sticks_of(many, number), sticks_of(plain, number)
            assert mine.shape == theirs.shape
            np.testing.assert_allclose(mine, theirs, rtol=0, atol=ULPS)


@pytest.mark.slow
def test_samples_are_the_simulations_of_what_was_drawn(uncertain):
    for number in (0, 1, 17, SAMPLES - 1):
        system, base, y0 = uncertain.realization(number)
        drawn = uncertain.input_values
        assert (system.friction.mu, system.stiffness, y0[0]) == tuple(
            drawn[name][number] for name in ("mu", "stiffness", "y0[0]")
        )
        one = ss.simulate(system, base, t1=T1, y0=y0)
        mask = np.asarray(one.sticks.mask)
        start = np.asarray(one.sticks.start)[mask]
        np.testing.assert_allclose(sticks_of(uncertain, number)[0], start, rtol=0, atol=ULPS)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"threads": 1}, {"chunk": 64}, {"chunk": 37, "threads": 2}], ids=str)
def test_chunks_and_threads_change_nothing(uncertain, options):
    other = run(uncertain.system, y0=uncertain.y0, **options)
    for name in ("start", "end", "position", "ending"):
        np.testing.assert_array_equal(getattr(other.sticks, name), getattr(uncertain.sticks, name))


@pytest.mark.slow
def test_an_input_changes_no_other_one(uncertain):
    alone = run(oscillator(ss.Uniform(0.2, 1.0)))
    np.testing.assert_array_equal(alone.input_values["mu"], uncertain.input_values["mu"])
    np.testing.assert_array_equal(run(samples=10, y0=(ss.Normal(0.0, 0.05), 0.0)).input_values["y0[0]"],
                                  uncertain.input_values["y0[0]"][:10])  # fmt: skip
    # And the base motion is that of the key and the number of the sample alone.
    np.testing.assert_array_equal(
        uncertain.realization(3).base.durations, LAW.sample(jax.random.fold_in(KEY, 3), T1).durations
    )


class Sampled:
    """A distribution that can only be drawn from, as those of some packages."""

    def sample(self, key):
        return 0.4 + 0.1 * jax.random.uniform(key)


DISTRIBUTIONS = {
    "uniform": (ss.Uniform(0.2, 1.0), st.uniform(0.2, 0.8)),
    "normal": (ss.Normal(5.0, 0.5), st.norm(5, 0.5)),
    "beta": (ss.Beta(2.0, 3.0), st.beta(2, 3)),
    "scipy": (st.gamma(4.0, scale=0.1), st.gamma(4.0, scale=0.1)),
    "sampled": (Sampled(), st.uniform(0.4, 0.1)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_draws_have_their_distribution(name):
    distribution, known = DISTRIBUTIONS[name]
    many = run(oscillator(distribution), samples=5000, t1=0.5, keep="totals")
    drawn = many.input_values["mu"]
    assert drawn.shape == (5000,)
    assert st.kstest(drawn, known.cdf).pvalue > 1e-3  # a fixed key
    lagged = st.spearmanr(drawn[1:], drawn[:-1]).statistic
    assert abs(lagged) * np.sqrt(5000) < 3.5


@pytest.mark.slow
def test_correlated_inputs():
    correlation = ss.GaussianCopula(["stiffness", "mu"], [[1.0, -0.8], [-0.8, 1.0]])
    many = run(
        oscillator(ss.Uniform(0.2, 1.0), st.lognorm(0.2, scale=100)),
        samples=5000,
        t1=0.5,
        keep="totals",
        correlation=correlation,
    )
    drawn = many.input_values
    rank = st.spearmanr(drawn["mu"], drawn["stiffness"]).statistic
    expected = 6 / np.pi * np.arcsin(-0.8 / 2)  # of a Gaussian copula
    assert abs(rank - expected) * np.sqrt(5000) < 4  # the standard error is below 1 / sqrt(samples)
    assert st.kstest(drawn["mu"], st.uniform(0.2, 0.8).cdf).pvalue > 1e-3


@pytest.mark.slow
def test_other_values_and_distributions_compile_nothing(caplog):
    def compiled(system, t1):
        caplog.clear()
        with jax.log_compiles(), caplog.at_level("WARNING"):
            run(system, keep="totals", t1=t1, samples=SAMPLES + 1)
        return [record for record in caplog.records if "Compiling" in record.message and "summarize" in record.message]

    jax.clear_caches()  # of what earlier tests compiled
    ones = np.ones(SAMPLES + 1)
    assert compiled(oscillator(ss.Uniform(0.2, 1.0), 90 * ones), 1.5)  # so that the log is known to show it
    for mu in (ss.Uniform(0.3, 0.4), ss.Exponential(0.5), st.uniform(0.2, 0.1), 0.5 * ones):
        assert not compiled(oscillator(mu, ss.Weibull(100.0, 3.0)), 1.0)


@pytest.mark.slow
def test_a_design_gives_numbers_and_realizations():
    values = ss.design.grid({"mu": [0.2, 0.5, 0.8], "rate": [1.0, 2.0]}, realization="common")
    many = run(samples=values)
    assert many.samples == 6
    np.testing.assert_array_equal(many.input_values["mu"], [0.2, 0.2, 0.5, 0.5, 0.8, 0.8])
    np.testing.assert_array_equal(many.input_values["rate"], [1, 2, 1, 2, 1, 2])
    plain = run(oscillator(0.5), samples=1)
    np.testing.assert_allclose(sticks_of(many, 3), sticks_of(plain, 0), rtol=0, atol=ULPS)  # realisation 0 for all

    uniform = ss.design.sobol(64, ["stiffness", "mu"], seed=3)
    many = run(oscillator(ss.Uniform(0.2, 1.0), st.lognorm(0.2, scale=100)), samples=uniform)
    np.testing.assert_allclose(many.input_values["mu"], 0.2 + 0.8 * uniform.u[:, 1], rtol=1e-15)
    np.testing.assert_allclose(many.input_values["stiffness"], st.lognorm(0.2, scale=100).ppf(uniform.u[:, 0]))
    system, base, y0 = many.realization(5)
    mask = np.asarray((one := ss.simulate(system, base, t1=T1, y0=y0)).sticks.mask)
    np.testing.assert_allclose(sticks_of(many, 5)[0], np.asarray(one.sticks.start)[mask], rtol=0, atol=ULPS)


def test_arrays_of_starts():
    starts = np.random.default_rng(0).normal(scale=0.1, size=(20, 2))
    many = run(samples=20, y0=starts)
    for number in (0, 19):
        _, base, y0 = many.realization(number)
        assert y0 == tuple(starts[number])
        one = ss.simulate(oscillator(), base, t1=T1, y0=y0)
        mask = np.asarray(one.sticks.mask)
        np.testing.assert_allclose(sticks_of(many, number)[0], np.asarray(one.sticks.start)[mask], rtol=0, atol=ULPS)


def test_every_number_of_a_long_start_has_a_word_of_its_own():
    """Of 1,000 blocks, with their velocities; those of the first 512 numbers are what they always were."""
    streams = [Input(("y0", i), ss.Uniform(0.0, 1.0), None).stream for i in range(2000)]
    assert len(set(streams)) == 2000
    assert all(1 << 31 <= stream < 1 << 32 for stream in streams)
    assert streams[:512] == [0xFFFFFE00 + i for i in range(512)]


@pytest.mark.slow
def test_inputs_are_stored(uncertain, tmp_path):
    again = ss.load(uncertain.save(tmp_path / "many.nc"))
    for name, values in uncertain.input_values.items():
        np.testing.assert_array_equal(again.input_values[name], values)
        np.testing.assert_array_equal(again.to_xarray()[f"input_{name}"], values)
    assert again.realization(5).system == uncertain.realization(5).system
    longer = again.extended(samples=20)
    np.testing.assert_array_equal(longer.input_values["mu"][:SAMPLES], uncertain.input_values["mu"])
    table = uncertain.write_sticks(tmp_path / "sticks.csv").read_text().splitlines()
    assert "mu" in table[0].split(",")


@pytest.mark.slow
def test_inputs_of_joined_parts_are_stored():
    parts = [run(oscillator(ss.Uniform(0.3, 0.7)), samples=20, t1=1.0, key=jax.random.key(seed)) for seed in (1, 2)]
    joined = ss.concatenate(parts)
    both = np.concatenate([part.input_values["mu"] for part in parts])
    np.testing.assert_array_equal(joined.input_values["mu"], both)
    np.testing.assert_array_equal(joined.to_xarray().input_mu, both)


@pytest.mark.slow
def test_single_precision():
    with jax.enable_x64(False):
        with pytest.warns(UserWarning, match="float32"):
            many = run(oscillator(ss.Normal(0.5, 0.05)), samples=64, t1=2.0)
        values = many.input_values["mu"]
    assert values.dtype == np.float32
    assert many.finished == 64


BAD = {
    "lengths": (
        lambda: run(oscillator(np.ones(5))),
        r"\AArgument system.friction.mu must hold one number for each of the 300",
    ),
    "nan": (lambda: oscillator(np.array([0.1] * 6 + [np.nan])), r"\AArgument mu\[6\] must be finite"),
    "negative": (lambda: oscillator(np.array([0.1, -0.1])), r"\AArgument mu\[1\] must be zero or positive"),
    "draws": (
        lambda: run(oscillator(ss.Normal(0.1, 0.1))),
        r"\AArgument mu must be .* but \d+ of the draws 0 to 299 are outside, first that of sample \d+; restrict",
    ),
    "relations": (
        lambda: run(oscillator(ss.Uniform(0.4, 0.6), mu_static=0.5)),
        r"\ASample \d+ does not fit: Argument mu_static must be at least mu",
    ),
    "no draws": (lambda: oscillator(object()), r"\AArgument mu must be a single real number"),
    "no key": (
        lambda: run(oscillator(ss.Uniform(0.1, 0.2)), ss.Constant(1.0), key=None),
        r"\AArgument key must be a key",
    ),
    "name": (
        lambda: run(oscillator(ss.Uniform(0.1, 0.2)), samples=ss.design.random(10, ["mue"])),
        r"\AArgument samples must name one of .*'mue' was given; did you mean 'mu'\?",
    ),
    "columns": (
        lambda: run(oscillator(ss.Uniform(0.1, 0.2)), samples=ss.design.random(10, dimensions=2)),
        r"\AArgument samples must be a design with one column for each of the 1 random",
    ),
    "value": (lambda: run(samples=ss.design.grid({"mu": [-1.0]})), r"\AArgument mu\[0\] must be zero or positive"),
    "not set": (
        lambda: run(samples=ss.design.grid({"damping": [1.0]})),
        r"\AArgument system.damping must be a number",
    ),
    "copula": (lambda: run(correlation=[[1.0]]), r"\AArgument correlation must be a GaussianCopula"),
    "copula's name": (
        lambda: run(oscillator(ss.Uniform(0.1, 0.2)), correlation=ss.GaussianCopula(["mu", "mass"], np.eye(2))),
        r"\AArgument correlation must name one of system.friction.mu, but 'mass'",
    ),
    "one simulation": (
        lambda: ss.simulate(oscillator(ss.Uniform(0.1, 0.2)), ss.SquareWave(1.0, 1.0), t1=1.0),
        r"\AArgument system.friction.mu must be one number here",
    ),
    "step": (
        lambda: run(oscillator(stiffness=ss.Uniform(100.0, 1e4)), TONE, samples=8, method=ss.Exact(step=0.05)),
        r"\AArgument step must be at most",
    ),
    "start": (
        lambda: run(y0=(np.zeros(3), 0.0)),
        r"\AArgument y0\[0\] must hold one number for each of",
    ),
    "extended": (
        lambda: run(oscillator(np.linspace(0.1, 1, 10)), samples=10).extended(samples=5),
        r"arrays with one number for each sample, which cannot be extended",
    ),
    "first sample": (
        lambda: run(samples=ss.design.grid({"mu": [0.1]}), first_sample=3),
        r"\AArgument first_sample must be 0 with a design",
    ),
}


@pytest.mark.parametrize("what", BAD)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_input(what):
    make, message = BAD[what]
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.slow
def test_what_is_drawn_is_an_ensemble_of_arrays(uncertain):
    """Drawn numbers, given as arrays, are the same ensemble."""
    drawn = uncertain.input_values
    many = run(oscillator(drawn["mu"], jnp.asarray(drawn["stiffness"])), y0=(drawn["y0[0]"], 0.1))
    for name in ("start", "end", "position", "ending"):
        np.testing.assert_array_equal(getattr(many.sticks, name), getattr(uncertain.sticks, name))
