# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Posteriors from a record of motion
#
# `ss.calibrate` gives estimates with Gaussian errors. `ss.log_likelihood` gives the whole density, as a function in JAX
# with derivatives, to the samplers of [numpyro](https://num.pyro.ai) and [blackjax](https://blackjax-devs.github.io);
# [arviz](https://python.arviz.org) then says how well they did. Here: both samplers on one density, compared with each
# other and with `calibrate`; and what the jumps of the density do to them where static friction exceeds kinetic
# friction, measured against quadrature. Needs `pip install 'stickslip_jax[inference]'`.

# %%
import os
import warnings

import blackjax
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import stickslip_jax as ss

with warnings.catch_warnings():  # arviz announces its next version; tqdm misses the widgets of its bars
    warnings.simplefilter("ignore")
    import arviz as az
    import numpyro
    from numpyro import distributions
    from numpyro.infer import MCMC, NUTS

jax.config.update("jax_enable_x64", True)

DRAWS = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "1000"))  # of each chain
WARMUP = min(DRAWS, 300)
CHAINS = 4
BASE = ss.Harmonic(0.5, 0.7)
TIMES = np.linspace(0.0, 12.0, 121)
START = (0.3, 0.1)


def measured(system, noise, seed):
    """A record of the position, with noise (m)."""
    one = ss.simulate(system, BASE, t1=TIMES[-1], y0=START)
    return np.asarray(one.evaluate(TIMES)[0]) + noise * np.random.default_rng(seed).normal(size=len(TIMES))


# %% [markdown]
# ## Three unknown numbers
#
# A mass of 1 kg with friction coefficient 0.7 on a spring of 4 N/m, seen for 12 s with noise of 0.02 m; it sticks three
# times. Friction coefficient, stiffness and noise are not known, the start is.

# %%
TRUTH = {"mu": 0.7, "stiffness": 4.0, "noise": 0.02}
record = measured(ss.MassSpring(1.0, TRUTH["stiffness"], 1.0, ss.Coulomb(TRUTH["mu"])), TRUTH["noise"], 0)
guess = ss.MassSpring(1.0, 3.5, 1.0, ss.Coulomb(0.6))
found = ss.calibrate(guess, BASE, TIMES, {"position": record}, wrt=("mu", "stiffness"), y0=START)
print(found)

# %% [markdown]
# The posterior: a prior, and the log likelihood as a factor. Priors that are wide beside what the record tells:
# log-normal ones, whose logarithms have a standard deviation of 0.5, and 1 for the noise.

# %%
likelihood = ss.log_likelihood(
    guess, BASE, TIMES, {"position": record}, wrt=("mu", "stiffness"), y0=START
)  # the noise is given in each call
MEDIANS = {"mu": 0.6, "stiffness": 3.5, "noise": 0.05}
SPREADS = {"mu": 0.5, "stiffness": 0.5, "noise": 1.0}
BEST = {name: found[name].value for name in ("mu", "stiffness")} | {"noise": found.noise["position"]}


def model():
    values = {
        name: numpyro.sample(name, distributions.LogNormal(np.log(MEDIANS[name]), SPREADS[name])) for name in MEDIANS
    }
    noise = values.pop("noise")
    numpyro.factor("record", likelihood(values, noise={"position": noise}))


# numpyro moves in the logarithms, whose errors are the relative ones: adaptation is short where they are given.
ERRORS = {name: found[name].standard_error / BEST[name] for name in ("mu", "stiffness")}
ERRORS["noise"] = 1 / np.sqrt(2 * len(TIMES))
kernel = NUTS(
    model,
    init_strategy=numpyro.infer.init_to_value(values=BEST),
    inverse_mass_matrix={tuple(ERRORS): jnp.array(list(ERRORS.values())) ** 2},
    max_tree_depth=6,
)
chains = MCMC(
    kernel, num_warmup=WARMUP, num_samples=DRAWS, num_chains=CHAINS, chain_method="vectorized", progress_bar=False
)
chains.run(jax.random.key(0), extra_fields=("diverging", "accept_prob"))
by_numpyro = az.from_numpyro(chains)

# %% [markdown]
# The same density for blackjax, as a function of the logarithms, in which log-normal priors are normal; counted from
# the estimates, in their errors.


# %%
def logarithms_of(position):
    return {name: np.log(BEST[name]) + ERRORS[name] * x for name, x in position.items()}


def log_density(position):
    logarithms = logarithms_of(position)
    values = {name: jnp.exp(x) for name, x in logarithms.items()}
    prior = sum(jax.scipy.stats.norm.logpdf(x, np.log(MEDIANS[name]), SPREADS[name]) for name, x in logarithms.items())
    noise = values.pop("noise")
    return prior + likelihood(values, noise={"position": noise})


def sampled(log_density, start, key, draws):
    """Draws of blackjax's NUTS, and what it says of each: acceptance, divergence, number of gradients."""
    warm, key = jax.random.split(key)
    adaptation = blackjax.window_adaptation(blackjax.nuts, log_density, max_num_doublings=6)
    (state, tuned), _ = adaptation.run(warm, start, num_steps=WARMUP)
    kernel = blackjax.nuts(log_density, **tuned)

    def step(state, key):
        state, info = kernel.step(key, state)
        return state, (state.position, info.acceptance_rate, info.is_divergent, info.num_integration_steps)

    return jax.lax.scan(step, state, jax.random.split(key, draws))[1]


begin = {name: jnp.zeros(CHAINS) for name in BEST}
keys = jax.random.split(jax.random.key(1), CHAINS)
positions, *told = jax.jit(jax.vmap(lambda start, key: sampled(log_density, start, key, DRAWS)))(begin, keys)
by_blackjax = az.from_dict(
    posterior={name: np.exp(x) for name, x in logarithms_of(positions).items()},
    sample_stats={"acceptance_rate": np.asarray(told[0]), "diverging": np.asarray(told[1])},
)

# %% [markdown]
# Units stay with the numbers as attributes. `az.summary` gives means, intervals, effective sample sizes and `r_hat`,
# which is 1 where the chains agree.

# %%
UNITS = {"mu": "1", "stiffness": "N/m", "noise": "m"}
for name, data in {"numpyro": by_numpyro, "blackjax": by_blackjax}.items():
    for variable, unit in UNITS.items():
        data.posterior[variable].attrs["units"] = unit
    print(name, az.summary(data, var_names=list(UNITS), kind="stats").round(4), sep="\n")
    print(f"divergences: {int(data.sample_stats['diverging'].sum())} of {CHAINS * DRAWS}")
worst = 0.0
for name in ("mu", "stiffness"):
    means, errors = [], []
    for data in (by_numpyro, by_blackjax):
        draws = data.posterior[name]
        means.append(float(draws.mean()))
        errors.append(float(az.mcse(data, var_names=[name])[name]))
    worst = max(worst, abs(means[0] - means[1]) / np.hypot(*errors))
    spread, gaussian = float(by_numpyro.posterior[name].std()), found[name].standard_error
    print(f"{name}: standard deviation {spread:.5f}, standard error by calibrate {gaussian:.5f}")
print(f"the means of both samplers agree within 4.5 of their errors: {worst < 4.5}")

# %% [markdown]
# This posterior is nearly Gaussian: the ellipses hold 50 and 95 % by the errors of `calibrate`.

# %%
figure, ax = plt.subplots(figsize=(6, 4.5), layout="constrained")
for data, color, name in ((by_numpyro, "#0072B2", "numpyro"), (by_blackjax, "#E69F00", "blackjax")):
    shown = data.posterior[["mu", "stiffness"]].stack(sample=("chain", "draw")).isel(sample=slice(None, None, 4))
    ax.plot(shown["mu"], shown["stiffness"], ".", ms=3, alpha=0.5, color=color, label=name)
angle = np.linspace(0, 2 * np.pi, 200)
root = np.linalg.cholesky(found.covariance)
for share in (0.5, 0.95):
    ellipse = np.sqrt(stats.chi2.ppf(share, 2)) * root @ np.array([np.cos(angle), np.sin(angle)])
    ax.plot(found["mu"].value + ellipse[0], found["stiffness"].value + ellipse[1], "k", lw=1)
ax.plot(TRUTH["mu"], TRUTH["stiffness"], "r*", ms=12, label="truth")
ax.set(xlabel="friction coefficient", ylabel="stiffness (N/m)")
ax.legend()
plt.show()

# %% [markdown]
# ## Where the density jumps
#
# With static friction above kinetic friction the motion itself jumps as a stick appears: a mass that just comes to rest
# is held until the force has grown to the static limit, one that just does not is never held. So the likelihood jumps
# as well. With plain Coulomb friction it is continuous, with a kink. Both are shown here for one unknown number, mu, by
# quadrature (2000 points) and by NUTS. The mass has the static coefficient 0.9, the kinetic one 0.4 is close to a jump.

# %%
PRIOR = (0.4, 0.05)  # mean and standard deviation of mu, normal
NOISE = 0.1
STATIC = 0.9
LAWS = ("mu_static = 0.9", "plain Coulomb")
RECORDS = max(6, DRAWS // 40)  # of each law
GRID = jnp.linspace(0.2, 0.6, 2001)
truths = np.append(0.4, np.random.default_rng(5).normal(*PRIOR, size=RECORDS - 1))  # the first one is shown


def of_record(law, mu, seed):
    """The likelihood by both coefficients of a record that was made with this mu."""
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(float(mu), mu_static=float(mu) if law else STATIC))
    seen = {"position": measured(system, NOISE, seed)}
    wrt = ("friction.mu", "mu_static")
    return ss.log_likelihood(system, BASE, TIMES, seen, wrt=wrt, noise={"position": NOISE}, y0=START)


def mu_at(position):
    return PRIOR[0] + 0.01 * position  # about the width of the posterior


def posterior(likelihood, law):
    def log_density(position):
        mu = mu_at(position)
        static = jnp.where(law == 0, STATIC, mu)
        return likelihood(jnp.stack([mu, static])) + jax.scipy.stats.norm.logpdf(mu, *PRIOR)

    return log_density


@jax.jit
def by_quadrature(likelihoods, laws):
    """The posterior probability of each point of the grid, (records, points)."""
    of_one = jax.vmap(lambda one, law: jax.lax.map(posterior(one, law), (GRID - PRIOR[0]) / 0.01, batch_size=64))
    return jax.nn.softmax(of_one(likelihoods, laws), axis=1)


@jax.jit
@jax.vmap
def by_nuts(likelihood, law, key):
    return sampled(posterior(likelihood, law), jnp.zeros(()), key, DRAWS // 2)


# Likelihoods of records with the same times are of one shape: stacked, they are sampled side by side.
laws = np.repeat([0, 1], RECORDS)
each = [of_record(law, mu, i) for i, (law, mu) in enumerate(zip(laws, np.tile(truths, 2), strict=True))]
stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
density = np.asarray(by_quadrature(stacked, laws))
draws, *told = jax.tree.map(np.asarray, by_nuts(stacked, laws, jax.random.split(jax.random.key(2), 2 * RECORDS)))
of_nuts = mu_at(draws), *told
results = {name: (density[laws == i], [each[laws == i] for each in of_nuts]) for i, name in enumerate(LAWS)}

# %%
figure, panels = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for ax, (name, (density, (draws, *_))) in zip(panels, results.items(), strict=True):
    ax.hist(draws[0], bins=40, density=True, color="#56B4E9", label="NUTS")
    ax.plot(GRID, density[0] / (GRID[1] - GRID[0]), "k", lw=1, label="quadrature")
    ax.axvline(truths[0], color="r", lw=1, label="truth")
    ax.set(xlabel="mu", ylabel="posterior density", title=name, xlim=(0.34, 0.48))
panels[0].legend()
plt.show()

# %% [markdown]
# What NUTS makes of it: its proposals follow derivatives that do not know of the jump, but each is accepted by the
# density itself. So its draws are right, jump or not; it needs more of them: steps get shorter, and draws more alike.
# Measured over all records: z-scores of the means by NUTS against those by quadrature (standard deviation 1 where they
# are right), and what an independent draw costs. With 40 records of each law it was 20 gradients where the density
# jumps and 7 where it does not, without divergences. Effective sample sizes are somewhat optimistic where a chain
# seldom crosses the jump: the largest of 40 z-scores was 4.2 with the jump, 3.4 without.


# %%
def effective(draws):
    """Effective sample size of each row of draws."""
    return np.array([float(az.ess(row[None])) for row in draws])


for name, (density, (draws, accepted, diverging, gradients)) in results.items():
    mean = density @ GRID
    spread = np.sqrt(density @ GRID**2 - mean**2)
    number = effective(draws)
    z = (draws.mean(axis=1) - mean) / (spread / np.sqrt(number))
    jump = np.max(np.abs(np.diff(np.log(density + 1e-300), axis=1)) * (density[:, 1:] > 1e-6), axis=1)
    print(
        f"{name}: acceptance {np.mean(accepted):.2f}, {1000 * np.mean(diverging):.1f} divergences in 1000 draws, "
        f"{np.sum(gradients) / np.sum(number):.0f} gradients for an independent draw, median of the largest jump of "
        f"log density {np.median(jump):.2f}"
    )
    print(
        f"  means by NUTS against quadrature: z from {z.min():.1f} to {z.max():.1f}, standard deviation {z.std():.2f}"
    )
    print(f"  means are right: {np.all(np.abs(z) < 4.5)}")

# %% [markdown]
# ## Calibration of the whole chain
#
# Each record was made with a mu drawn from the prior. Then the share of draws below that mu is uniform in [0, 1] over
# the records, if simulation, likelihood and sampler are right (Talts and others, 2018). The Gaussian errors of the
# second derivative at the mode have no such property where there is a jump.

# %%
figure, ax = plt.subplots(figsize=(6, 3.5), layout="constrained")
for name, (_, (draws, *_)) in results.items():
    ranks = np.mean(draws[1:] < truths[1:, None], axis=1)
    test = stats.kstest(ranks, "uniform")
    print(f"{name}: shares of {RECORDS - 1} records uniform, p = {test.pvalue:.2f}; not rejected: {test.pvalue > 1e-3}")
    ax.plot(np.sort(ranks), (np.arange(len(ranks)) + 0.5) / len(ranks), ".-", label=name)
ax.plot([0, 1], [0, 1], "k", lw=1)
ax.set(xlabel="share of draws below the truth", ylabel="share of records")
ax.legend()
plt.show()
