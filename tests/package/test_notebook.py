"""The notebooks run from top to bottom, draw their figures, and print the numbers that their text names."""

import os
import re
from pathlib import Path

import jupytext
import nbformat
import pytest
from support.scripts import loaded

pytestmark = pytest.mark.documents
FOLDER = Path(__file__).parents[2] / "notebooks"
FIGURES = {
    "quickstart": 7,
    "conference_paper": 4,
    "parametric_oscillator": 5,
    "statistical_model": 7,
    "electromechanical": 8,
    "parametric_analysis": 5,
    "control": 3,
    "sensitivity": 3,
    "regularized": 2,
    "pipeline": 2,
    "own_system": 4,
    "own_base": 3,
    "base_isolation": 5,
    "isolated_building": 3,
    "uncertain": 2,
    "calibration": 2,
    "scaling": 2,
    "structures": 5,
    "nonlinear": 5,
    "measured_friction": 2,
    "posterior": 3,
    "abc": 2,
}
"""And how many figures each draws."""
PRINTED = {
    "quickstart": (
        "Ensemble of 100 samples",
        r"largest share: 38\.67 % at r = 1\.22",
        r"d\(mu\) = (\S+) s, by finite difference (\S+) s",
    ),
    "conference_paper": (
        r"1 stick, released at 0\.25 s; then the radius is 1 m/s within \d\.\de[+-]\d\d",
        r"by the area of the ellipse 80\.4 %",
        r"or neither: 2000 of 2000",
        r"r = 0\.4: 0 sticks .* 2 different circles about \+0\.5 m/s, 2 different circles about -0\.5 m/s",
        r"r = 2: 0 sticks in the last 10 periods",
        r"with the period 1 / \(r omega\), at r = 1\.2: 0\.00 %",
        r"most: 38\.[6-9]\d % at r = 1\.22",
        r"r = 0\.4: 0\.00 %",
        r"r = 0\.76: 19\.10 %",
        r"r = 1\.2: 36\.43 %",
        r"no stick from r = 1\.4188 on",
        r"sticks from r = 0\.110 to 0\.1\d\d, .* shares of five starts differ by at most (0\.0e\+00|\d\.\de-1\d)",
        r"sticks from r = 0\.760 to 1\.410, .* shares of five starts differ by at most (0\.0e\+00|\d\.\de-1\d)",
        r"(?s)(over 0\.6 to 2\.5: \S+ to \S+ %, level within a tenth: False.*){4}",
    ),
    "parametric_oscillator": (
        r"start \(-0\.9, 0\.0\): .* 0 at x < 0; the sign of the power is as said at 2001, .* at 2001",
        r"start \(-0\.2, 1\.0\): .* 34 at x < 0; the sign of the power is as said at 2001, .* at 1967",
        r"the last circle, 3\.1416 s: the belt supplied 3\.1416 J, heat 3\.1416 J",
        r"constant belt: at most 1 stick, from 0 s on",
        "the belt supplied 10.3579 J, friction turned 11.3482 J into heat",
        "exactly where the formula says so at 49 of 49 points",
        r"mu = 1: at most 38\.5 % of a steady period, at r = 1\.225",
    ),
    "statistical_model": (
        r"mean of number of sticks: 5\d\.\d\d \+- 0\.\d\d",
        "slips less sticks of a sample: -1 to 1",
        r"foretold: exp\(-1\.357\) / 2 = 0\.1287 of the samples, 0\.0022\d of all sticks",
        r"with random starts: share of repeated values of stick duration: 0 \+- 0",
        r"    2     1 .* \+- 0\.01\d\d \*.* 0\.1\d{3} \+- 0\.01\d\d \* +-0\.1\d{3} \+- 0\.01\d\d \*",
        r"sticks are identically distributed from number \d on, as far as 100 samples tell",
        r"mu = 2, rate = 1/s: independence rejected of stick, stick; stick, slip; slip, stick",
        r"mu = 1, rate = 1/s: a renewal process of independent phases (not )?rejected by 100 samples",
        r"slip_start Spearman, orders 1 and 2: p = \S+; rank correlation 0\.8",
    ),
    "control": (
        r"Are the forecasts calibrated\? No evidence against it at the 5 % level",
        r"after a release 4\.920 s; after a reversal at 0, 0\.4 and 0\.8 m \[1\.\d+ 1\.1\d* 0\.8\d*\] s",
        r"prediction lessens the stick share by more than ten standard errors: True",
        r"by the gain: -0\.\d+ \+- 0\.\d+, by differences -0\.\d+ \+- 0\.\d+: [0-3]\.\d standard errors apart",
    ),
    "electromechanical": (
        r"mu = 0\.2: at pi/2 0\.10315 s",
        r"mu = 0\.6: at pi/2 inf s; no stick at 19\.1 % of the angles, no limit at 30\.8 %",
        r"mu \|sin alpha\| > 0\.17698, for ever where it is > 0\.53093",
        r"by at most 9 mA of 4\.9 A",
        r"with 9\.8 m/s\^2 the longest stick at mu = 0\.5 is 1\.0 ms shorter",
        r"mu = 0\.2, the paper's count, with the initial rest: 100 of 100 samples have a first stick, of [1-4] ms",
        r"mu = 0\.5: 1\.0000 \+- 0\.0000 of the samples have a first stick, 0 of these are longer",
        r"mu = 0\.2, with the initial rest: 9\d % of the first sticks are shorter than 5 ms",
    ),
    "parametric_analysis": (
        r"Sweep of 64 points \(8 mu x 8 rate\), 100 samples each",
        r"95 % confidence intervals: at most \d+\.\d\d %",
        r"along rate: the sweep's mean number of sticks again at 8 of 8 points",
        r"along mu: the sweep's mean number of sticks again at 8 of 8 points",
        r"stick_count, \d+ bins: entropy from",
        r"slip duration, mu \S+, rate \S+/s: entropy [23]\.\d{3} nat, \d\d of 53 bins in use",
        r"d log / d log mu of mean stick duration \(pooled\): 0\.[89]",
        r"along rate: mean_stick_count grows.*, from \d",
        r"along mu: mean_stick_duration grows.*, from 0\.\d",
        r"d log / d log mu of mean number of sticks: ",
        r"d log / d log rate of mean slip duration \(pooled\): -0\.\d+ \+- 0\.\d+",
    ),
    "sensitivity": (
        r"automatic differentiation gives the first of these two: True",
        r"number of sticks of the realisation: 45 to 73, in 31 jumps",
        r"derivative of the mean number, \d+\.\d, by automatic differentiation: 0\.0",
        r"mu and normal force have one elasticity: True",
    ),
    "regularized": (
        r"trajectories that did not reach t1: 0",
        r"the stick lasts from 13\.1002 to 13\.4667 s",
        r"the same numbers of sticks: True True",
    ),
    "pipeline": (
        r"five calls, traced and compiled: 1",
        r"ensemble and pipeline agree sample by sample: True",
        r"gradient and differences agree: True",
        r"the wish is met: True",
    ),
    "own_system": (
        r"sticks begin at 0\.2138225744 rad, by the closed form 0\.2138225744 rad",
        r"closed forms hold within 1e-9 rad: True",
        r"largest difference of 10 events: \d\.\de-\d\d s, below 1e-8 s: True",
        r"they agree within 1e-5: True",
    ),
    "own_base": (
        r"velocity and acceleration agree within 1e-8 m/s\^2: True",
        r"(?s)(within five standard errors: True.*){4}",
        r"the record misses the function by 1\.1e-04 m/s, at most 1\.1e-04 m/s",
    ),
    "base_isolation": (
        r"supplied 682\.6332 J, dissipated by friction 681\.3582 J",
        r"by lsim the same within 1e-8 m: True",
        r"mu_static just above 0\.4080: 0 slips; just below: it slides: True",
        r"never further than 1 mm from the run: True",
    ),
    "isolated_building": (
        r"sum of masses times total accelerations within 1e-6 N: True",
        r"friction has dissipated (\S+) kJ, friction force times slip path \1 kJ",
        r"all finished: True; sliding of the fixed building: 0 m",
        r"drift by lsim the same within 1e-9 m: True",
        r"more friction, a stronger earthquake to reach the edge: True",
    ),
    "uncertain": (
        r"half-width, mu: first order \S+ \+- \S+ \(exact 0\.6600\), total \S+ \+- \S+ \(exact 0\.6733\)",
        r"start and realisation: 0 in total",
        r"mu 1\.1052 to 1\.1052 times as large, the force smaller: the numbers of sticks are the same in 100 %",
    ),
    "calibration": (
        r"base speed 0\.7 m/s, 9477 sticks: mean stick duration \(pooled\): 0\.4301 \+- 0\.0025 s",
        r"mu, speed and start doubled: the same durations to the last bit: True",
        r"naive, 0\.268 s by differences",
        r"mu: 1\.20\d* \+- 0\.0\d+ from mean durations, 1\.20\d* \+- 0\.00\d+ from 12 moments",
        r"mu: with 95 % confidence between 1\.1[89]\d and 1\.2[0-3]\d",
    ),
    "scaling": (
        r"numbers that are those of a sweep never stopped: (\d+) of \1\b",
        r"batches done by a third run: 0",
        r"mu = 1\.6: samples for rates 0\.3, 0\.6, 1\.2, 2\.4 \(foretold\): 2100 .*1500 .*1300 .*1000 ",
        r"numbers of two processes that are those of one thread: 38 of 38",
    ),
    "structures": (
        # The numbers of an independent integration from event to event, at a relative tolerance of 1e-12.
        r"clutch 0 sticks: 0\.7916623592 to 0\.8311085061 s, 0\.9068501928 to 1\.0002958599 s",
        r"clutch 1 sticks: 0\.7096214747 to 1\.5",
        r"clutch 2 sticks: 1\.1439674925 to 1\.5",
        r"angular momentum is kept within 1e-9 kg m\^2/s: True",
        r"never further apart than 2 mm: True",
        r"fixed: .* by lsim the same within 1e-8 m: True",
        r"floating: .* by lsim the same within 1e-8 m: True",
        r"all runs finished: True",
        r"falls from each friction coefficient to the next: True",
    ),
    "measured_friction": (
        r"0\.5 Hz, 25 mm: error 0\.03\d of the force",
        r"stiffness_forward: [34]\.\d+e\+11 \+- \d\S*e\+0?9 N/m\^3 .* \(made with 4e\+11\)",
        r"growth_length: 0\.00[23]\d* \+- \S+ m .* \(made with 0\.003\)",
        r"2 Hz, 12 mm: error 0\.0[34]\d* of the force, predicted with the fitted numbers",
        r"79% of it outside the range of the fit, by 4\.0 times in speed, 1\.0 in slip path",
        r"the band of 95 % holds (9[5-9]|100)% of it \([4-6]\d% as wide as inside\)",
    ),
    "nonlinear": (
        r"period 12\.001031295 s, multipliers \[1\. 0\.\]",  # Leine and others 1998
        r"stick vanishes at 1\.83660097\d m/s: .*; the branch turns round there",  # by scipy 1.836600973
        r"frequency 0\.8: stick appears at 0\.817406",
        r"frequency 0\.4: stick appears at 0\.143890",
        r"closed form 0\.817406",
        r"all finished: True",
        r"no chaotic motion repeats itself: True",
        r"2 attractors, shares \[0\.\d+ 0\.\d+\]",
        r"the unstable cycle: converged True, stable False",
    ),
    "posterior": (
        r"(?s)(divergences: 0 of \d+.*){2}",
        r"the means of both samplers agree within 4\.5 of their errors: True",
        r"(?s)(means are right: True.*){2}",
        r"(?s)(not rejected: True.*){2}",
    ),
    "abc": (
        r"the truth is within 99 % of each: True",
        r"mu, adjusted: p = \S+; not rejected: True",
        r"rate, adjusted: p = \S+; not rejected: True",
    ),
}
"""And what each prints, as regular expressions: numbers that do not depend on the number of samples."""


def tool():
    return loaded("tools/notebooks.py")


_CASES = [pytest.param(name, marks=() if name == "quickstart" else pytest.mark.slow) for name in FIGURES]


@pytest.fixture(scope="module", params=_CASES)
def executed(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("notebook")
    around = {
        "STICKSLIP_NOTEBOOK_SAMPLES": "100",
        "IPYTHONDIR": str(folder / "ipython"),
        "JUPYTER_RUNTIME_DIR": str(folder / "runtime"),
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in around.items():
            patch.setenv(name, value)
        notebook = tool().execute(jupytext.read(FOLDER / f"{request.param}.py"), folder)
    if kept := os.environ.get("STICKSLIP_KEEP_NOTEBOOKS"):  # for the site, which shows them
        Path(kept).mkdir(parents=True, exist_ok=True)
        nbformat.write(notebook, Path(kept) / f"{request.param}.ipynb")
    return request.param, notebook


def outputs(notebook):
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def printed(notebook):
    return "".join(output.text for output in outputs(notebook) if output.output_type == "stream")


def test_figures_are_drawn_whatever_the_backend_chosen_outside(tmp_path, monkeypatch):
    """`tools/notebooks.py` with MPLBACKEND=Agg, as it is set on machines without a screen."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    cell = "import os\nimport matplotlib.pyplot as plt\nplt.plot([1, 2])\nprint(os.environ['WITH'])"
    done = tool().execute(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell)]), WITH="this too")
    assert any("image/png" in output.get("data", {}) for output in outputs(done))
    assert printed(done) == "this too\n"


def test_every_notebook_is_here():
    assert {path.stem for path in FOLDER.glob("*.py")} == set(FIGURES)


def test_every_cell_ran(executed):
    _, notebook = executed
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert not [output for output in outputs(notebook) if output.output_type == "error"]


def test_nothing_was_warned_of(executed):
    complaints = [output.text for output in outputs(executed[1]) if output.get("name") == "stderr"]
    assert not [text for text in complaints if "Warning" in text]


def test_every_figure_is_drawn(executed):
    name, notebook = executed
    assert sum("image/png" in output.get("data", {}) for output in outputs(notebook)) == FIGURES[name]


def test_numbers_told(executed):
    name, notebook = executed
    for promised in PRINTED[name]:
        assert re.search(promised, printed(notebook)), (promised, printed(notebook))


STATED = {
    "conference_paper": (
        (r"most: (\S+) % at r = (\S+)", "{:.1f} % at r = {:.3f}"),
        (r"no stick from r = (\S+) on", "| {:.4f} on |"),
        (r"below 0\.4 up to (\S+) %.* between 0\.7 and 0\.8 up to (\S+) %", "up to {:.1f} % and {:.1f} %;"),
        (r"a period at r = 2\.5: (\S+) %", "{:.1f} % with a new direction in each period"),
        (r"r = 1\.0: (\S+) %[^$]*r = 1\.3: (\S+) %", "{:.1f} %; {:.1f} % of a steady period"),
    ),
    "electromechanical": (
        (r"mu = 0\.2: at pi/2 (\S+) s", "| {:.5f} s there |"),
        (r"is possible where mu \|sin alpha\| > (\d\.\d+)", "sticks need `mu abs(sin alpha) > {:.3f}`"),
        (r"for ever where it is > (\d\.\d+)", "where `mu abs(sin alpha) > {:.3f}`"),
        (r"mu = 0\.6: .* no limit at (\S+) %", "{:.1f} % of the angles at 0.6"),
        (r"physical +0 rad/s +\d+ +(\d+)[^$]*physical +10 rad/s +0 +(\d+)", "| {1:.0f} to {0:.0f} of 1,000 at mu"),
    ),
}
"""What is printed at full size, and how docs/validation.md states these numbers."""


@pytest.mark.slow
@pytest.mark.parametrize("name", STATED)
def test_the_table_of_the_papers_is_made_of_what_is_printed(name, tmp_path):
    told = printed(tool().execute(jupytext.read(FOLDER / f"{name}.py"), tmp_path, IPYTHONDIR=str(tmp_path / "ipython")))
    table = (FOLDER.parent / "docs/validation.md").read_text(encoding="utf-8")
    for promised, stated in STATED[name]:
        found = re.search(promised, told)
        assert found, (promised, told)
        assert stated.format(*map(float, found.groups())) in table, (stated, found[0])
