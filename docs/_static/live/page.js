// The page: what the sliders say is simulated, printed and drawn; at once, before the next picture of the screen.
"use strict";
(() => {
  const { ensemble, figures, random, statistics } = globalThis.stickslip;
  const SAMPLES = 2000;
  const FIXED = { mass: 1, stiffness: 4, normalForce: 1, t1: 50, y0: [0, 1] };
  const DECIMALS = { mu: 2, speed: 2, rate: 1, sample: 0 };
  const UNITS = { mu: "", speed: " m/s", rate: " /s", sample: "" };

  const draws = ensemble.drawsOf(random.keyOf(0), SAMPLES);
  const element = (name) => document.getElementById(`live-${name}`);

  function python(value) {
    return Number.isInteger(value) ? `${value}.0` : String(value);
  }

  /** The code that gives the same numbers. */
  function codeOf({ mu, speed, rate, t1, y0, mass, stiffness, normalForce }, sample) {
    const law =
      speed > 0
        ? `ss.PoissonSwitching(speed=${python(speed)}, rate=${python(rate)})`
        : "ss.Constant(speed=0.0)  # a belt at rest";
    const [m, k, n] = [mass, stiffness, normalForce].map(python);
    return `import jax
import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)
system = ss.MassSpring(
    mass=${m}, stiffness=${k}, normal_force=${n}, friction=ss.Coulomb(mu=${python(mu)})
)
law = ${law}
many = ss.simulate_ensemble(
    system, law, t1=${python(t1)}, samples=${SAMPLES}, key=jax.random.key(0), y0=(${y0.map(python).join(", ")})
)
print(ss.mean_stick_duration(many))
print(ss.mean_stick_count(many))
print(ss.stick_fraction(many))

system, base, y0 = many.realization(${sample})
one = ss.simulate(system, base, t1=${python(t1)}, y0=y0)
print(one)
ss.plot.phase_portrait(one)
`;
  }

  /** What the sliders say, which is printed beside them. */
  function settings() {
    const values = {};
    for (const name of Object.keys(DECIMALS)) {
      const value = Number(element(name).value);
      values[name] = value;
      const text = value.toFixed(DECIMALS[name]) + UNITS[name];
      element(`${name}-value`).textContent = text;
      element(name).setAttribute("aria-valuetext", text);
    }
    return values;
  }

  function print(name, found, unit) {
    const field = element(name);
    field.textContent = Number.isNaN(found.value) ? "not defined: no stick" : statistics.withError(found) + unit;
    Object.assign(field.dataset, found); // all digits, for those who look closely
  }

  function update() {
    const began = performance.now();
    const { sample, ...moved } = settings();
    const model = { ...FIXED, ...moved };
    element("figures").dataset.belt = model.speed > 0 ? "moves" : "rests";
    const many = ensemble.simulateEnsemble(model, draws);
    const one = ensemble.simulateOne(model, draws[sample]);
    const found = statistics.statisticsOf(many);
    print("mean-stick-duration", found.mean_stick_duration, " s");
    print("mean-stick-count", found.mean_stick_count, "");
    print("stick-fraction", found.stick_fraction, "");
    element("sticks").textContent = many.durations.length.toLocaleString("en");
    element("sticks-of-one").textContent = String(one.sticks.length);
    element("code").textContent = codeOf(model, sample);
    figures.phasePortrait(element("portrait"), one, model);
    figures.timeHistory(element("history"), one, model);
    figures.durations(element("histogram"), statistics.histogram(many.durations), found.mean_stick_duration.value);
    element("milliseconds").textContent = (performance.now() - began).toFixed(0);
  }

  let waits = false;
  function updateSoon() {
    if (waits) return;
    waits = true;
    requestAnimationFrame(() => {
      waits = false;
      update();
    });
  }

  element("controls").addEventListener("input", updateSoon);
  element("controls").addEventListener("submit", (event) => event.preventDefault());
  element("controls").addEventListener("reset", () => setTimeout(updateSoon)); // the sliders move after the event
  new ResizeObserver(updateSoon).observe(element("histogram"));
  new MutationObserver(updateSoon).observe(document.documentElement, { attributeFilter: ["data-theme"] });
  element("figures").hidden = false;
  update();
  globalThis.stickslip.page = { draws, model: () => ({ ...FIXED, ...settings() }) };
})();
