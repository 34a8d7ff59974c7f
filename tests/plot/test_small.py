"""What notebooks show of results: tables that hold the numbers, and a small figure that leaves nothing behind."""

import base64
import dataclasses
import re
import xml.etree.ElementTree as ET

import equinox as eqx
import jax
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from support.plot import T1, simulate

import stickslip_jax as ss
from stickslip_jax.plot._small import _MANY, _image

SVG = "{http://www.w3.org/2000/svg}"


def tables(shown):
    """The cells of each table, row by row. The HTML is parsed as XML, so every tag is closed and every & escaped."""
    page = ET.fromstring("<div>" + re.sub("(<img[^>]*)>", r"\1/>", shown) + "</div>")
    return [[[cell.text or "" for cell in row] for row in one.findall("tr")] for one in page.findall("table")]


def figure_of(shown):
    """The SVG in a page."""
    (data,) = re.findall('src="data:image/svg[+]xml;base64,([^"]*)"', shown)
    return ET.fromstring(base64.b64decode(data))


@pytest.fixture(scope="module")
def one():
    many = simulate(4)
    _, base, y0 = many.realization(0)
    return ss.simulate(many.system, base, t1=T1, y0=y0)


@pytest.mark.slow
def test_simulation(one):
    shown = one._repr_html_()
    (table,) = tables(shown)
    told = dict(table)
    assert int(told["sticks"]) == one.sticks.count
    assert float(told["stick fraction"]) == pytest.approx(float(one.stick_fraction), rel=1e-5)
    assert told["system"] == "MassSpring"
    # Two panels; sticks in the colour of sticks.
    svg = figure_of(shown)
    assert [group.get("id") for group in svg.iter(f"{SVG}g") if str(group.get("id")).startswith("axes")] == [
        "axes_1",
        "axes_2",
    ]
    assert "#d55e00" in ET.tostring(svg, encoding="unicode").lower()
    assert plt.get_fignums() == []


@pytest.mark.slow
def test_simulations_that_are_not_one(one):
    assert one._repr_html_.__self__ is one
    batch = jax.tree.map(lambda *leaves: np.stack(leaves), one, one)
    assert batch._repr_html_() is None
    seen = []
    jax.jit(lambda traced: seen.append(traced._repr_html_()))(one)
    assert seen == [None]
    stopped = (ss.Status.OUT_OF_STEPS, 12.5)
    stopped = eqx.tree_at(lambda of: (of.status, of.time_reached), one, tuple(map(np.asarray, stopped)))
    shown = stopped._repr_html_()
    assert "NOT FINISHED: stopped at 12.5 s" in shown
    assert "<img" in shown  # the part that there is
    never = eqx.tree_at(lambda of: of.time_reached, stopped, np.asarray(0.0))
    assert "<img" not in never._repr_html_()


def test_ensemble(many):
    shown = many._repr_html_()
    (table,) = tables(shown)
    told = dict(table)
    mean = ss.mean_stick_duration(many)
    assert told[mean.name] == f"{mean.without_name().replace('+-', '±')}"
    assert "Coulomb" in told["system"]
    assert "PoissonSwitching" in told["law"]
    assert figure_of(shown) is not None
    assert plt.get_fignums() == []
    lost = dataclasses.replace(many, status_counts={ss.Status.FINISHED: 199, ss.Status.OUT_OF_STEPS: 1})
    (table,) = tables(lost._repr_html_())
    assert next(text for name, text in table if name.startswith("NOT FINISHED")).startswith("1 samples, because")
    totals = dataclasses.replace(many, retained=None, accumulator=None)
    assert tables(totals._repr_html_())
    assert "<img" not in totals._repr_html_()


def test_statistics(many):
    summary, statistics = many.summary(), many.statistics
    assert tables(summary._repr_html_()) == [
        [list(head), *map(list, rows)] for _, head, rows in summary.tables
    ] == tables(statistics._repr_html_())  # fmt: skip
    assert repr(summary).startswith(repr(statistics))
    second = statistics.order(2)
    (table,) = tables(second._repr_html_())
    assert [row[0] for row in table[1:]] == [f"{of.name} ({of.unit})" for of in second.distributions.values()]
    assert str(second.share) in repr(second)


def test_distribution(many, none):
    shown = many.statistics.duration._repr_html_()
    (table,) = tables(shown)
    assert dict(table)["mean"] == many.statistics.duration.mean.without_name().replace("+-", "±")
    assert float(dict(table)["largest"]) == pytest.approx(many.statistics.duration.largest, rel=1e-5)
    assert figure_of(shown) is not None
    empty = none.statistics.duration._repr_html_()
    assert empty == "<p><b>stick duration: no values in 3 samples</b></p>"


def test_many_points_are_stored_as_an_image():
    def draw(number):
        return _image((3.0, 2.0), 1, lambda axes: axes[0].plot(np.random.default_rng(0).normal(size=number)))

    assert next(figure_of(draw(_MANY + 1)).iter(f"{SVG}image"), None) is not None
    assert next(figure_of(draw(_MANY - 1)).iter(f"{SVG}image"), None) is None
    assert len(draw(10 * _MANY)) < 200_000
    assert mpl.rcParams["font.size"] == mpl.rcParamsDefault["font.size"]
