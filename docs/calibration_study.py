"""Draw the figure of the page on calibration: ``python docs/calibration_study.py``.

Friction estimated from records of 20 s, with exact friction and with friction that a tanh smooths.
"""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

RECORDS = 12
WIDTHS = (0.3, 0.1, 0.03, 0.01, 0.003)  # m/s
TIMES = np.linspace(0.0, 20.0, 401)
BASE, START, MU = ss.SquareWave(0.5, 5.0), (0.3, 0.1), 0.7


def oscillator(mu: float) -> ss.MassSpring:
    """The mass on a spring of the page."""
    return ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu))


def estimates(method: ss.Exact | ss.Regularized) -> tuple[np.ndarray, float]:
    """Estimates from all records, (records,), and the mean of their standard errors."""
    clean = np.asarray(ss.simulate(oscillator(MU), BASE, t1=20.0, y0=START).evaluate(TIMES)[0])
    noise = 0.01 * clean.std()
    found = []
    for seed in range(RECORDS):
        seen = clean + noise * np.random.default_rng(seed).normal(size=len(TIMES))
        found.append(
            ss.calibrate(
                oscillator(0.6), BASE, TIMES, {"position": seen}, wrt="mu", noise={"position": noise}, y0=START,
                windows=1, method=method,
            )["mu"]
        )  # fmt: skip
    return np.array([one.value for one in found]), float(np.mean([one.standard_error for one in found]))


def main() -> None:
    """Write docs/calibration_bias.png, and print what it shows."""
    jax.config.update("jax_enable_x64", True)
    exact, error = estimates(ss.Exact())
    print(f"exact: bias {np.mean(exact) - MU:+.5f} +- {np.std(exact, ddof=1) / RECORDS**0.5:.5f}, "
          f"scatter {np.std(exact, ddof=1):.5f}, standard error {error:.5f}")  # fmt: skip
    smooth = {width: estimates(ss.Regularized(width)) for width in WIDTHS}
    for width, (found, _) in smooth.items():
        print(
            f"tanh of width {width} m/s: bias {np.mean(found) - MU:+.5f}, {(np.mean(found) - MU) / error:+.1f} errors"
        )
    _, ax = plt.subplots(figsize=(6.0, 3.8), layout="constrained")
    for width, (found, _) in smooth.items():
        ax.plot(np.full(RECORDS, width), found, ".", color="#0072B2", ms=4)
    widths = np.array(WIDTHS)
    ax.plot(widths, [np.mean(found) for found, _ in smooth.values()], color="#0072B2", lw=1.2,
            label="smoothed friction, each record and the mean")  # fmt: skip
    ax.axhspan(np.mean(exact) - error, np.mean(exact) + error, color="#D55E00", alpha=0.3, lw=0,
               label="exact friction: mean and one standard error")  # fmt: skip
    ax.axhline(MU, color="black", lw=1.0, ls="--", label="truth")
    ax.set(xscale="log", xlabel="width of the tanh (m/s)", ylabel="estimated friction coefficient")
    ax.legend(fontsize=8)
    path = Path(__file__).with_name("calibration_bias.png")
    plt.savefig(path, dpi=150)
    print(f"wrote {path.name}")


if __name__ == "__main__":
    main()
