// Means over samples with standard errors, and histograms. As stickslip_jax/_statistics/totals.py.
"use strict";
(() => {
  const BINS = 50;

  function mean(values) {
    return values.reduce((sum, value) => sum + value, 0) / values.length;
  }

  /**
   * The mean of `above` over the mean of `below`, and its standard error over samples (delta method).
   *
   * NaN where the denominator is 0.
   */
  function ratio(above, below) {
    const denominator = mean(below);
    if (!(denominator > 0)) return { value: NaN, error: NaN };
    const value = mean(above) / denominator;
    const squares = above.map((number, sample) => (number - value * below[sample]) ** 2);
    return { value, error: Math.sqrt(mean(squares) / (above.length - 1)) / denominator };
  }

  /** The statistics that the page prints, by the names that they have in the package. */
  function statisticsOf({ samples, t1, totals }) {
    const always = (value) => new Float64Array(samples).fill(value);
    const numbered = (all, rest) => all.map((value, sample) => value - rest[sample]);
    return {
      mean_stick_duration: ratio(
        numbered(totals.stickTime, totals.restTime),
        numbered(totals.stickCount, totals.restCount),
      ),
      mean_stick_count: ratio(totals.stickCount, always(1)),
      stick_fraction: ratio(totals.stickTime, always(t1)),
    };
  }

  /** Counts of `values` in equal bins from 0 to the largest: the density (1/unit) times the bin width sums to 1. */
  function histogram(values, bins = BINS) {
    const largest = values.reduce((most, value) => Math.max(most, value), 0);
    const width = largest / bins;
    const counts = new Float64Array(bins);
    for (const value of values) counts[Math.min(Math.floor(value / width), bins - 1)] += 1;
    return { width, counts, density: counts.map((count) => count / (values.length * width)), largest };
  }

  /** As the package prints it: the error to two digits, the value to the same decimal place. */
  function withError({ value, error }) {
    if (Number.isNaN(value)) return "not defined";
    if (!(error > 1e-12 * Math.abs(value))) return `${Number(value.toPrecision(6))} ± 0`; // all samples are alike
    const decimals = Math.max(0, 1 - Math.floor(Math.log10(error)));
    return `${value.toFixed(decimals)} ± ${error.toFixed(decimals)}`;
  }

  globalThis.stickslip.statistics = { histogram, ratio, statisticsOf, withError };
})();
