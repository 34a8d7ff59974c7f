"""Outputs of a user's own in sweeps: those of the ensemble at each point, stored and read again."""

import jax
import numpy as np
import pytest

import stickslip_jax as ss

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
PEAK = ss.Output(lambda one: one.peak("position"), unit="m")


def sweep_of(outputs, **more):
    run = {"t1": 10.0, "samples": 40, "key": jax.random.key(0), "batch": 16, "keep": "totals"} | more
    return ss.Sweep(SYSTEM, POISSON, over={"mu": [0.5, 1.0]}, outputs=outputs, **run)


@pytest.mark.slow
def test_outputs_at_each_point(tmp_path):
    sweep = sweep_of({"peak": PEAK})
    found = sweep.run(tmp_path / "sweep", progress=False, threads=1)
    for index, mu in enumerate((0.5, 1.0)):
        many = ss.simulate_ensemble(
            ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu)), POISSON, t1=10.0, samples=40, key=jax.random.key(0),
            outputs={"peak": PEAK},
        )  # fmt: skip
        peaks = many.output_values["peak"]
        assert found.peak_mean.values[index] == pytest.approx(peaks.mean(), rel=1e-9)
        assert found.peak_mean_error.values[index] == pytest.approx(peaks.std(ddof=1) / np.sqrt(40), rel=1e-9)
        assert found.peak_values.values[index] == 40
    assert found.peak_mean.attrs["units"] == "m"
    assert found.peak_quantile.dims == ("mu", "quantile")
    np.testing.assert_array_equal(sweep.ensemble_at(mu=1.0, progress=False).output_values["peak"], peaks)

    again = sweep_of({"peak": PEAK}).run(tmp_path / "sweep", progress=False, threads=1)  # all of it is stored
    np.testing.assert_array_equal(again.peak_mean.values, found.peak_mean.values)
    with pytest.raises(ss.SweepError, match=r"its outputs \(peak\) are functions of your own, which are not stored"):
        ss.Sweep.load(tmp_path / "sweep")
    other = ss.Output(lambda one: one.maximum("position"), unit="m")
    with pytest.raises(ss.SweepError, match=r"outputs: .* there, .* here"):
        sweep_of({"peak": other}).run(tmp_path / "sweep", progress=False)


@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_outputs():
    with pytest.raises(ValueError, match="Argument outputs must have names of its own, but 'mu' is the name of a para"):
        sweep_of({"mu": PEAK})
    with pytest.raises(ValueError, match=r"cannot be simulated: Argument outputs\['wrong'\] must .* returned 'x'"):
        sweep_of({"wrong": lambda one: "x"})
