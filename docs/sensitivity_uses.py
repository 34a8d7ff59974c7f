"""Two uses of corrected derivatives: ``python -m docs.sensitivity_uses``, a minute. Results: docs/sensitivity.md.

1. The friction coefficient is fitted to an observed mean stick duration and stick fraction.
2. The base speed is chosen that holds the stick fraction at a limit: the slowest, which costs the least power.
"""

import jax
import jax.numpy as jnp
import optimistix as optx

import stickslip_jax as ss

MASS, STIFFNESS, NORMAL_FORCE = 1.0, 4.0, 1.0
RATE, T1, START = 1.0, 60.0, (ss.Uniform(-0.5, 0.5), ss.Uniform(-0.5, 0.5))
SAMPLES = 4096
TRUE_MU, OFF = 1.3, 1.15  # the model of the fit is off: durations are observed longer than it knows


def system(mu):
    """The oscillator of the study, at another friction coefficient."""
    return ss.MassSpring(MASS, STIFFNESS, NORMAL_FORCE, ss.Coulomb(mu))


def naive_statistics(mu):
    """Mean stick duration and stick fraction as JAX differentiates them: the number of sticks is a constant to it."""
    law = ss.PoissonSwitching(1.0, RATE)

    def one(number):
        key = jax.random.fold_in(jax.random.key(1), number)
        x, v = jax.random.uniform(jax.random.fold_in(key, 7), (2,), minval=-0.5, maxval=0.5)
        base = law.sample(key, T1, capacity=120)
        run = ss.simulate(system(mu), base, t1=T1, y0=(x, v))
        return run.stick_time, run.sticks.count

    time, count = jax.vmap(one)(jnp.arange(SAMPLES))
    return jnp.sum(time) / jnp.sum(count), jnp.mean(time) / T1


def fit(statistics, observed):
    """The mu whose statistics fit best in relative terms, the number of steps, and the relative misfits there."""

    def misfit(mu, _):
        return jnp.stack([got / seen - 1 for got, seen in zip(statistics(mu), observed, strict=True)])

    solver = optx.GaussNewton(rtol=1e-4, atol=1e-6)
    found = optx.least_squares(misfit, solver, jnp.asarray(0.9), max_steps=60, throw=False)
    return float(found.value), int(found.stats["num_steps"]), misfit(found.value, None)


def main() -> None:
    """Print what docs/sensitivity.md tells."""
    law = ss.PoissonSwitching(1.0, RATE)
    settings = {"t1": T1, "samples": SAMPLES, "key": jax.random.key(0), "y0": START}
    seen = ss.simulate_ensemble(system(TRUE_MU), law, t1=T1, samples=40_000, key=jax.random.key(9), y0=START)
    observed = OFF * ss.mean_stick_duration(seen).value, ss.stick_fraction(seen).value
    print(f"observed: mean stick duration {observed[0]:.4f} s, stick fraction {observed[1]:.4f}")

    corrected = [
        ss.differentiable(statistic, system(1.2), law, wrt="mu", **settings)
        for statistic in (ss.mean_stick_duration, ss.stick_fraction)
    ]
    for name, statistics in (
        ("corrected", lambda mu: [statistic(mu) for statistic in corrected]),
        ("naive", naive_statistics),
    ):
        mu, steps, misfits = fit(statistics, observed)
        print(f"{name}: mu = {mu:.4f} after {steps} steps, sum of squares {float(misfits @ misfits):.6f}")

    limit = 0.1
    share = ss.differentiable(ss.stick_fraction, system(1.3), law, wrt="speed", **settings)
    found = optx.root_find(
        lambda speed, _: share(speed) - limit, optx.Newton(rtol=1e-6, atol=1e-6), jnp.asarray(1.0), throw=False
    )
    print(f"slowest base with a stick fraction of at most {limit:.0%}: {float(found.value):.4f} m/s, there "
          f"{float(share(found.value)):.4f}, after {int(found.stats['num_steps'])} steps")  # fmt: skip


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
