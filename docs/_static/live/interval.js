// The motion of a mass on a spring while its base has a constant velocity, in closed form: at most one stick.
// As stickslip_jax/_dynamics/interval/arcs.py, which explains the rules. Times in s, positions in m.
"use strict";
(() => {
  const EPSILON = 2 ** -52;
  const TOUCH_ULPS = 4096; // round-off up to which an arc from below is tangent to the base velocity
  const REST_ULPS = 128; // and up to which a mass on a base at rest is at rest
  const FEW = 256 * EPSILON; // how far round-off can have moved the state: an interval shorter than that is no stick
  const CLOCK_ULPS = 4;

  /** Parameters of the closed forms: the angular frequency, rad/s, and `alpha`, the deceleration by friction, m/s^2. */
  function scalesOf({ mass, stiffness, normalForce, mu }, t1) {
    const squared = stiffness / mass;
    const omega = Math.sqrt(squared);
    const alpha = (mu * normalForce) / mass;
    const clock = Math.min(1 / omega, t1);
    const restSpeed = REST_ULPS * EPSILON * alpha * clock;
    return { squared, omega, alpha, clock, restSpeed };
  }

  /** The angle of the vector (x, y) with y >= 0, in [0, pi]. Adding 0 makes a zero positive. */
  function angleOf(y, x) {
    return Math.atan2(y, x + 0);
  }

  /** Position and velocity after the time t, from x, v and the deceleration A, on an arc about its centre. */
  function swung(x, v, A, t, { squared, omega }) {
    const angle = 0.5 * omega * t;
    const twice = (2 * Math.sin(angle)) / omega;
    const cosine = Math.cos(angle);
    const half = 0.5 * twice;
    return [x + twice * (v * cosine - A * half), v - twice * (A * cosine + v * squared * half)];
  }

  /** The arc from the first state: its side (1 below the base velocity, -1 above), and where and when it meets that. */
  function firstArc(x, v, q, scales) {
    const { squared, omega, alpha, restSpeed } = scales;
    let pull = squared * x;
    const atRest = q === 0 && Math.abs(v) <= restSpeed && Math.abs(pull) <= (1 + REST_ULPS * EPSILON) * alpha;
    if (atRest) {
      pull = Math.min(Math.max(pull, -alpha), alpha);
      v = 0;
    }
    const side = v > q || (v === q && pull < -alpha) ? -1 : 1;
    const A = side * pull - alpha;
    const turned = omega * q;
    const touch = TOUCH_ULPS * EPSILON * (A * A + turned * turned + alpha * (Math.abs(A) + turned));
    const excess = A * A + squared * ((v - q) * (v + q));
    const meets = atRest || excess > (v < q ? touch : 0);
    const H = excess > 0 ? Math.sqrt(excess) : 0;
    const far = H + Math.abs(A);
    const half = A <= 0 ? angleOf(omega * Math.abs(v - q), far) : angleOf(far, -side * omega * (v + q));
    return { side, A, v, H, meets, time: (2 * half) / omega };
  }

  /**
   * Carry the state (x, v) across an interval of the base velocity `base` that lasts `span`, from `began` on.
   *
   * Returns the state at its end, whether there was a stick (`stuck`), when it began and ended (`entered`, `left`,
   * from the beginning of the interval), where it began (`position`), and whether friction gave way (`released`), after
   * a stick or where the mass arrived.
   * `draw`, if given, is told of each part of the motion: draw(kind, x, v, A, begin, end), where A is the deceleration
   * in an arc, and `kind` "slip" or "stick".
   */
  function carryAcross(x, v, base, span, scales, began, draw = null) {
    const { squared, omega, alpha, clock, restSpeed } = scales;
    const mirror = base < 0 ? -1 : 1;
    const q = Math.abs(base);
    const told = (kind, x, v, A, begin, end) => draw(kind, mirror * x, mirror * v, mirror * A, begin, end);
    x *= mirror;
    const first = firstArc(x, mirror * v, q, scales);
    let { side, H, time: entered } = first;
    let arrived = first.meets && entered < (1 + FEW) * span;
    const meets = arrived;
    if (draw) told("slip", x, first.v, side * first.A, 0, meets ? entered : span);
    // Crossings of the base velocity, where the spring is too strong for friction to hold the mass.
    while (arrived && (2 + 2 * FEW) * alpha < H) {
      side = -side;
      H -= 2 * alpha;
      const arrival = entered + (2 / omega) * angleOf(H, -side * omega * q);
      arrived = arrival < (1 + FEW) * span;
      if (draw) told("slip", (side * (alpha + H)) / squared, q, side * H, entered, arrived ? arrival : span);
      if (arrived) entered = arrival;
    }
    // The stick, from the last arrival until the spring reaches the limit of friction.
    const position = (side * (alpha - (arrived ? H : -H))) / squared;
    const lacks = side > 0 ? H : 2 * alpha - H;
    const release = q > 0 ? entered + lacks / (squared * q) : Infinity;
    const released = arrived && release <= span;
    const left = released ? release : span;
    // An interval without length is no stick.
    const length = left - entered - CLOCK_ULPS * EPSILON * began;
    const speedError = FEW * (q + (3 / (REST_ULPS * EPSILON)) * restSpeed);
    const lasts = lacks > 4 * FEW * alpha && length * H > (released && side > 0 ? 0 : speedError);
    const stuck = arrived && (lasts || length > Math.sqrt(FEW) * clock);
    const leftAt = arrived ? position + q * (left - entered) : position;
    if (draw && stuck) told("stick", position, q, 0, entered, left);
    // The last motion: from the release, from the last crossing, or along the first arc.
    const start = meets ? leftAt : x;
    const speed = meets ? q : first.v;
    const A = arrived ? 0 : side * (meets ? H : first.A);
    const rest = span - (arrived ? left : meets ? entered : 0);
    const [xEnd, vEnd] = swung(start, speed, A, rest, scales);
    if (draw && released) told("slip", start, speed, A, left, span);
    const end = { x: mirror * xEnd, v: mirror * vEnd };
    return { ...end, stuck, entered, left, position: mirror * position, released };
  }

  globalThis.stickslip.interval = { carryAcross, scalesOf, swung };
})();
