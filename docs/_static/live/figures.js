// The three figures: phase portrait and time history of one realisation, histogram of all stick durations.
"use strict";
(() => {
  const { axes, interval } = globalThis.stickslip;
  const { Axes } = axes;
  const STICK_WIDTH = 3.2; // px, as in the package's figures
  const SLIP_WIDTH = 1.2;
  const POINT = 4; // px
  const TURN = 0.08; // rad between the points of an arc
  const SHOWN = 20; // s of the time history

  /** Points [t, x, v] of a part of the motion: the ends of a stick, and an arc closely. */
  function pointsOf({ kind, x, v, A, begin, end }, scales) {
    const number = kind === "stick" ? 1 : Math.max(1, Math.ceil((scales.omega * (end - begin)) / TURN));
    return Array.from({ length: number + 1 }, (_, index) => {
      const t = ((end - begin) * index) / number;
      const state = kind === "stick" ? [x + v * t, v] : interval.swung(x, v, A, t, scales);
      return [begin + t, ...state];
    });
  }

  /** Limits with some room around the values; around 0 where there is none between them. */
  function around(values) {
    const low = values.reduce((least, value) => Math.min(least, value), Infinity);
    const high = values.reduce((most, value) => Math.max(most, value), -Infinity);
    const room = high > low ? 0.06 * (high - low) : 1;
    return [low - room, high + room];
  }

  /** The lines of the parts of the motion by how they look: sticks, and slips by the direction of the base. */
  function lookOf({ kind, base }) {
    if (kind === "stick") return "stick";
    return base > 0 ? "forward" : base < 0 ? "backward" : "at-rest";
  }

  function phasePortrait(canvas, one, model) {
    const scales = interval.scalesOf(model, model.t1);
    const lines = { forward: [], backward: [], "at-rest": [], stick: [] };
    for (const part of one.parts) lines[lookOf(part)].push(pointsOf(part, scales).map(([, x, v]) => [x, v]));
    const points = Object.values(lines).flat(2);
    const center = (model.mu * model.normalForce) / model.stiffness;
    const plot = new Axes(canvas, {
      x: around([...points.map(([x]) => x), -center, center]),
      y: around(points.map(([, v]) => v)),
      xlabel: "position x (m)",
      ylabel: "velocity ẋ (m/s)",
    });
    for (const [look, some] of Object.entries(lines)) {
      plot.lines(some, look, look === "stick" ? STICK_WIDTH : SLIP_WIDTH);
    }
    if (model.speed === 0) plot.dots(lines.stick.flat(), "stick", POINT); // sticks are points there
    plot.crosses([[-center, 0], [center, 0]], "base");
  }

  function timeHistory(canvas, one, model) {
    const scales = interval.scalesOf(model, model.t1);
    const until = Math.min(SHOWN, model.t1);
    const parts = one.parts.filter((part) => part.begin < until);
    const motion = (kind) =>
      parts.filter((part) => part.kind === kind).map((part) => pointsOf(part, scales).map(([t, , v]) => [t, v]));
    const base = parts.flatMap((part) => [[part.begin, part.base], [part.end, part.base]]);
    const slips = motion("slip");
    const plot = new Axes(canvas, {
      x: [0, until],
      y: around([...slips.flat().map(([, v]) => v), ...base.map(([, v]) => v)]),
      xlabel: `time t (s): the first ${until} s of ${model.t1} s`,
      ylabel: "velocity (m/s)",
    });
    plot.lines([base], "base", SLIP_WIDTH, [6, 4]);
    plot.lines(slips, "backward", SLIP_WIDTH);
    plot.lines(motion("stick"), "stick", STICK_WIDTH);
  }

  /** `found`: of `statistics.histogram`; `mean`: of the durations, s. */
  function durations(canvas, found, mean) {
    const plot = new Axes(canvas, {
      x: [0, found.largest || 1],
      y: [0, found.largest ? 1.06 * Math.max(...found.density) : 1],
      xlabel: "stick duration (s)",
      ylabel: "probability density (1/s)",
    });
    if (!found.largest) {
      plot.say("no stick in any realisation");
      return;
    }
    plot.bars(found.width, found.density, "stick");
    plot.lines([[[mean, 0], [mean, plot.limits.y[1]]]], "backward", 1.5, [5, 4]);
  }

  globalThis.stickslip.figures = { durations, phasePortrait, timeHistory };
})();
