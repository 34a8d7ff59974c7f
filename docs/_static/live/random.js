// The random numbers of the package: JAX's threefry-2x32 (Salmon et al. 2011), 32-bit integers and floats of 64 bits.
// As `random_words` and `exponential` in stickslip_jax/_numerics/elementary.py.
"use strict";
(() => {
  const PARITY = 0x1bd11bda;
  const ROTATIONS = [[13, 15, 26, 6], [17, 29, 16, 24]];
  const BEGINNING = 0xffffffff; // the number of the word that draws what comes before the first interval

  /** The two 32-bit words number `counter` of the stream of the key, two 32-bit words. */
  function randomWords([first, second], counter) {
    const schedule = [first | 0, second | 0, first ^ second ^ PARITY];
    let x = schedule[0];
    let y = (counter + schedule[1]) | 0;
    for (let group = 0; group < 5; group++) {
      for (const rotation of ROTATIONS[group % 2]) {
        x = (x + y) | 0;
        y = x ^ ((y << rotation) | (y >>> (32 - rotation)));
      }
      x = (x + schedule[(group + 1) % 3]) | 0;
      y = (y + schedule[(group + 2) % 3] + group + 1) | 0;
    }
    return [x >>> 0, y >>> 0];
  }

  /** `jax.random.key(seed)`, for a seed below 2^32. */
  function keyOf(seed) {
    return [0, seed >>> 0];
  }

  /** An exponential number of mean 1, from two random words: -log((j + 1/2) / 2^52). */
  function exponential([high, low]) {
    return -Math.log((high * 2 ** 20 + (low >>> 12) + 0.5) * 2 ** -52);
  }

  /**
   * What `PoissonSwitching` draws for one sample, whatever its speed and rate: the sign of the first velocity, and the
   * durations of the intervals in units of their mean. They are drawn when they are asked for, and kept.
   */
  class Draws {
    constructor(key, sample) {
      this.key = randomWords(key, sample);
      this.sign = randomWords(this.key, BEGINNING)[0] < 2 ** 31 ? 1 : -1;
      this.durations = [];
    }

    duration(interval) {
      while (this.durations.length <= interval) {
        this.durations.push(exponential(randomWords(this.key, this.durations.length)));
      }
      return this.durations[interval];
    }
  }

  globalThis.stickslip = { random: { Draws, exponential, keyOf, randomWords } };
})();
