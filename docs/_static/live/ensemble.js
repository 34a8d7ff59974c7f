// Samples of a mass on a base of randomly switching velocity, as `simulate_ensemble` simulates them.
"use strict";
(() => {
  const { random, interval } = globalThis.stickslip;

  /**
   * Follow one sample, interval by interval, up to t1.
   *
   * `model`: mass (kg), stiffness (N/m), normalForce (N), mu, speed (m/s), rate (1/s), t1 (s), y0 (m, m/s). A base of
   * speed 0 is at rest and never switches. `onStick(start, end, position, duration, ending)` is told of each stick;
   * endings are "released", "switched" and "horizon". `draw`, if given, of each part of the motion, its times from
   * t = 0: draw(kind, x, v, A, begin, end, baseVelocity).
   */
  function followSample(model, scales, draws, onStick, draw = null) {
    const { speed, rate, t1 } = model;
    let [x, v] = model.y0;
    let base = draws.sign * speed;
    let t = 0;
    for (let number = 0; t < t1; number++) {
      const duration = speed > 0 ? draws.duration(number) * (1 / rate) : Infinity;
      const isLast = t + duration >= t1;
      const end = isLast ? t1 : t + duration;
      const part = draw && ((kind, x, v, A, begin, until) => draw(kind, x, v, A, t + begin, t + until, base));
      const passage = interval.carryAcross(x, v, base, isLast ? t1 - t : duration, scales, t, part);
      if (passage.stuck) {
        const ending = passage.released ? "released" : isLast ? "horizon" : "switched";
        const stickEnd = passage.released ? t + passage.left : end;
        onStick(t + passage.entered, stickEnd, passage.position, passage.left - passage.entered, ending);
      }
      ({ x, v } = passage);
      t = end;
      base = -base;
    }
  }

  /** The numbers that `count` samples of the key draw, kept for all values of the sliders. */
  function drawsOf(key, count) {
    return Array.from({ length: count }, (_, sample) => new random.Draws(key, sample));
  }

  /**
   * The totals of each sample, arrays of numbers, and the durations (s) of all sticks but those that begin at t = 0.
   *
   * `restTime`, `restCount`: the part of `stickTime` (s) and `stickCount` that such an initial stick has.
   */
  function simulateEnsemble(model, draws) {
    const scales = interval.scalesOf(model, model.t1);
    const totals = {};
    for (const name of ["stickTime", "stickCount", "restTime", "restCount"]) {
      totals[name] = new Float64Array(draws.length);
    }
    const durations = [];
    draws.forEach((own, sample) => {
      followSample(model, scales, own, (start, end, position, duration) => {
        totals.stickTime[sample] += duration;
        totals.stickCount[sample] += 1;
        if (start === 0) {
          totals.restTime[sample] = end;
          totals.restCount[sample] = 1;
        } else {
          durations.push(end - start);
        }
      });
    });
    return { samples: draws.length, t1: model.t1, totals, durations };
  }

  /** One sample: its `sticks`, and the `parts` of its motion, which `drawing.js` draws. */
  function simulateOne(model, draws) {
    const sticks = [];
    const parts = [];
    followSample(
      model,
      interval.scalesOf(model, model.t1),
      draws,
      (start, end, position, duration, ending) => sticks.push({ start, end, position, ending }),
      (kind, x, v, A, begin, end, base) => parts.push({ kind, x, v, A, begin, end, base }),
    );
    return { sticks, parts };
  }

  globalThis.stickslip.ensemble = { drawsOf, simulateEnsemble, simulateOne };
})();
