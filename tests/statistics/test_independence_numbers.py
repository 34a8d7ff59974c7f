"""Tests of independence and identical distribution: their numbers on small data, what they refuse, and their words."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, stats
from support.independence import autoregressive, flat, iid, rows, shared, spearman_of

from stickslip_jax._dynamics.sticks import FlatSticks, with_columns
from stickslip_jax._statistics.independence import (
    HypothesisTest,
    anderson_darling,
    holm,
    identically_distributed,
    independent,
    independent_and_identical,
    limit_tail,
)


def unwrapped(verdict):
    """The text of a verdict, each of its sentences on one line."""
    return str(verdict).replace("\n    ", " ")


def by_sample(sticks, values=None):
    """The values (durations) of each sample, as a list of arrays."""
    values = sticks.end - sticks.start if values is None else values
    return np.split(values, np.cumsum(sticks.count)[:-1])


@pytest.fixture(scope="module")
def sticks():
    """Few, and with many ties."""
    rng = np.random.default_rng(5)
    count = rng.integers(0, 7, 120)
    return flat(count, rng.integers(1, 9, count.sum()).astype(float))


class TestNumbers:
    """Small data worked out otherwise: by loops, by scipy, by hand, by published numbers."""

    def test_orders(self, sticks):
        """Sample i is asked for the order of index i modulo 3."""
        groups = {1: [], 2: [], 4: []}
        for number, values in enumerate(by_sample(sticks)):
            order = (1, 2, 4)[number % 3]
            groups[order] += list(values[order - 1 : order])
        together, pairs = identically_distributed(sticks, orders=(4, 1, 2), starts_before=math.inf).tests
        assert together.sizes == tuple(map(len, groups.values()))
        expected = stats.anderson_ksamp(list(groups.values()), variant="midrank", method=None)
        assert together.statistic == pytest.approx(expected.statistic, rel=1e-10)
        assert together.p_value == pytest.approx(expected.pvalue, rel=0.05)  # scipy's is interpolated in a table
        single = [stats.ks_2samp(groups[a], groups[b], method="exact") for a, b in itertools.combinations(groups, 2)]
        assert [part.p_value for part in pairs.parts] == pytest.approx([one.pvalue for one in single])
        assert pairs.effect == max(one.statistic for one in single)
        assert pairs.p_value == min(1, 3 * min(one.pvalue for one in single))

    @pytest.mark.parametrize("lag", [1, 2])
    def test_pairs(self, sticks, lag):
        verdict = independent(sticks, lag=lag, first=2, bins=2, starts_before=math.inf)
        pairs = np.array([(values[1], values[1 + lag]) for values in by_sample(sticks) if len(values) > 1 + lag])
        spearman, square, _ = verdict.tests
        expected = stats.spearmanr(*pairs.T)
        assert (spearman.effect, spearman.p_value) == pytest.approx((expected.statistic, expected.pvalue))
        median = np.median(pairs)
        above = pairs > median
        table = [[np.sum(np.all(above == (early, late), axis=1)) for late in (0, 1)] for early in (0, 1)]
        expected = stats.chi2_contingency(table, correction=False)
        assert (square.statistic, square.p_value) == pytest.approx((expected.statistic, expected.pvalue))
        assert square.effect == pytest.approx(math.sqrt(expected.statistic / len(pairs)))

    @pytest.mark.parametrize("lag", [1, 3])
    def test_serial(self, sticks, lag):
        """Sum by sum: ranks in each stratum, their products, and the squares of the samples' shares."""
        samples = by_sample(sticks)
        above, squares, shares = 0.0, np.zeros(2), np.zeros(len(samples))
        for order in range(max(map(len, samples)) - lag):
            having = [number for number, values in enumerate(samples) if len(values) > order + lag]
            ranks = [stats.rankdata([samples[number][at] for number in having]) for at in (order, order + lag)]
            a, b = ((2 * rank - 1) / len(having) - 1 for rank in ranks)
            above += a @ b
            squares += a @ a, b @ b
            shares[having] += a * b * (math.sqrt(len(having) / (len(having) - 1)) if len(having) > 1 else 1)
        test = independent(sticks, lag=lag, starts_before=math.inf).tests[2]
        assert test.effect == pytest.approx(above / math.sqrt(squares[0] * squares[1]))
        z, number = above / math.sqrt(shares @ shares), sum(len(values) > lag for values in samples)
        assert test.statistic == pytest.approx(z * math.sqrt((number - 1) / (number - z**2)))
        assert test.p_value == pytest.approx(2 * stats.t.sf(abs(test.statistic), number - 1))

    def test_which_slips_and_positions(self):
        """Slips follow their stick, the last is cut; positions belong to all sticks, cut ones included."""
        end = np.array([2.0, 5.0, 9.0, 3.0, 4.0])
        start = np.array([1.0, 3.0, 8.5, 1.0, 3.5])
        ending = np.array([0, 1, 2, 0, 0])
        sticks = FlatSticks.of(np.array([3, 0, 2]), start, end, ending, position=np.arange(5.0))
        for quantity, used, left in (("duration", 4, 1), ("slip_duration", 3, 1), ("position", 5, 0)):
            verdict = identically_distributed(sticks, quantity, starts_before=math.inf)
            assert verdict.values == used
            assert (f"left out {left}," in unwrapped(verdict)) == (left > 0)
        # By default the longest of its kind counts back from 9 s, 2 s, but no more than half of the time: slips begin
        # before 4.5 s, and that from 4 s to the end counts as 4.5 s; the same for positions, whose slips before them
        # begin at 0, 2, 5, 0 and 3 s.
        for quantity, used in (("duration", 4), ("slip_duration", 3), ("position", 4)):
            assert identically_distributed(sticks, quantity).values == used

    def test_slips_and_positions_are_read(self):
        rng = np.random.default_rng(6)
        slips = np.exp(autoregressive(rng, 500, 6, np.full(500, 0.5)))
        sticks = flat(np.full(500, 6), rng.gamma(2, 1, 3000), slips.ravel())
        sticks = with_columns(sticks, position=autoregressive(rng, 500, 6, np.full(500, 0.8)).ravel())
        effects = [independent(sticks, quantity, starts_before=math.inf).tests[2] for quantity in
                   ("duration", "slip_duration", "position")]  # fmt: skip
        for test, truth in zip(effects, (0.0, 0.5, 0.8), strict=True):
            assert abs(test.effect - spearman_of(truth)) < 4 * test.effect_error

    def test_published_example_of_anderson_darling(self):
        """Smoothness of paper by four laboratories, Scholz and Stephens 1987: 4.480 with midranks."""
        laboratories = [
            [38.7, 41.5, 43.8, 44.5, 45.5, 46.0, 47.7, 58.0],
            [39.2, 39.3, 39.7, 41.4, 41.8, 42.9, 43.3, 45.8],
            [34.0, 35.0, 39.0, 40.0, 43.0, 43.0, 44.0, 45.0],
            [34.0, 34.8, 34.8, 35.4, 37.2, 37.8, 41.2, 42.8],
        ]
        statistic, p_value = anderson_darling([np.array(values) for values in laboratories])
        assert statistic == pytest.approx(4.480, abs=5e-4)
        assert p_value == pytest.approx(0.0020, abs=5e-4)

    def test_limiting_law(self):
        """Two degrees: a sum of exponentials, P = sum (-1)^(j + 1) (2 j + 1) exp(-j (j + 1) x / 2).

        One degree: percentage points of Marsaglia and Marsaglia 2004; densities there are below 1.
        """
        j = np.arange(1, 100)
        for x in (0.3, 1.0, 5.0, 60.0, 600.0):
            series = ((-1.0) ** (j + 1) * (2 * j + 1) * np.exp(-j * (j + 1) * x / 2)).sum()
            assert limit_tail(x, 2) == pytest.approx(series, rel=1e-11)
        for x, chance in ((1.9330, 0.10), (2.4924, 0.05), (3.8781, 0.01)):
            assert limit_tail(x, 1) == pytest.approx(chance, abs=1e-4)

    @pytest.mark.slow
    @pytest.mark.parametrize("degrees", [1, 4, 40])
    def test_moments_of_the_limiting_law(self, degrees):
        """Mean: degrees; variance: 2 degrees (pi^2 / 3 - 3). Both are integrals over the tail."""
        tail = [integrate.quad(lambda x, n=n: n * x ** (n - 1) * limit_tail(x, degrees), 0, degrees + 60,
                               limit=200, points=[0.05 * degrees, degrees])[0] for n in (1, 2)]  # fmt: skip
        assert tail[0] == pytest.approx(degrees, rel=1e-7)
        assert tail[1] - tail[0] ** 2 == pytest.approx(2 * degrees * (math.pi**2 / 3 - 3), rel=1e-6)

    def test_holm(self):
        assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx((0.03, 0.06, 0.06, 0.02))
        assert holm([0.7, math.nan, 0.6]) == pytest.approx((1, math.nan, 1), nan_ok=True)
        assert holm([]) == ()


NOTHING = FlatSticks.of(np.zeros(0, int), np.zeros(0), np.zeros(0), np.zeros(0, int))
ASKED = (identically_distributed, independent, independent_and_identical)


class TestEdges:
    @pytest.mark.parametrize("ask", ASKED)
    @pytest.mark.parametrize("quantity", ["duration", "position", "slip_duration"])
    @pytest.mark.parametrize(
        "sticks",
        [
            NOTHING,
            NOTHING._replace(count=np.zeros(7, int)),
            with_columns(flat([50], np.linspace(1, 2, 50)), position=np.zeros(50)),
            with_columns(flat(np.full(30, 1), np.full(30, 9.0), horizon=5.0), position=np.zeros(30)),
            with_columns(flat(np.full(4, 3), np.linspace(1, 2, 12)), position=np.zeros(12)),
        ],
        ids=["no samples", "no sticks", "one sample", "all cut", "few"],
    )
    def test_not_decided(self, ask, quantity, sticks):
        verdict = ask(sticks, quantity)
        assert verdict.rejected is None
        assert verdict.reason
        assert math.isnan(verdict.p_value)
        assert all(not test.made and test.reason and "not made" in repr(test) for test in verdict.tests)
        assert "Not decided" in str(verdict)

    def test_orders_beyond_any_count(self):
        sticks = rows(np.random.default_rng(1).gamma(2, 1, (200, 3)))
        verdict = identically_distributed(sticks, orders=10, starts_before=math.inf)
        assert verdict.rejected is False
        assert verdict.tests[0].sizes == (20, 20, 20)
        assert "Orders left out, with fewer than 5 values: 4, 5, 6, 7, 8, 9, 10." in unwrapped(verdict)
        assert identically_distributed(sticks, orders=(3, 4)).rejected is None
        assert independent(sticks, lag=3).rejected is None

    def test_equal_durations(self):
        """All alike are identically distributed; of dependence they tell nothing. Different constants differ."""
        alike = rows(np.full((100, 5), 0.3))  # 0.3 s cannot be added up exactly
        assert np.ptp(alike.end - alike.start) > 0
        assert identically_distributed(alike, starts_before=math.inf).p_value == 1
        verdict = independent_and_identical(alike, starts_before=math.inf)
        assert verdict.rejected is None
        assert verdict.reason == "all values of one order are equal"
        apart = identically_distributed(rows(np.full((100, 2), [1.0, 2.0])), orders=2, starts_before=math.inf)
        assert apart.rejected
        assert apart.tests[0].effect == math.inf

    def test_what_is_not_used_is_not_read(self):
        sticks = iid(np.random.default_rng(9))
        assert np.isnan(sticks.position).all()
        other = with_columns(sticks, position=np.arange(len(sticks.position)))
        assert repr(independent_and_identical(sticks)) == repr(independent_and_identical(other))

    def test_sources(self):
        """An ensemble is asked for its finished sticks; single precision and other integers do as well."""
        sticks = iid(np.random.default_rng(10))
        expected = independent(sticks, starts_before=40.0)
        others = dict.fromkeys(("t1", "moments", "status_counts", "finished_sticks", "require_sticks"), 0.0)
        ensemble = SimpleNamespace(numbered_sticks=lambda: sticks, **others)
        assert independent(ensemble, starts_before=40.0) == expected
        small = sticks._replace(count=sticks.count.astype(np.int32), numbers=sticks.numbers.astype(np.float32))
        assert independent(small, starts_before=40.0).p_value == pytest.approx(expected.p_value, rel=1e-2)

    def test_words_of_one_test(self):
        assert repr(HypothesisTest("Name", 2.0, 0.0, 0.5, "distance")) == "Name: p < 1e-300; distance 0.5"
        with_error = HypothesisTest("Name", 2.0, 0.0123, 0.5, "distance", 0.02)
        assert repr(with_error) == "Name: p = 0.012; distance 0.5 +- 0.02"
        assert with_error.line(0.05).startswith("Name: p = 0.012, adjusted for all tests p = 0.05; ")
        parts = tuple(HypothesisTest(f"Part {p}", 2.0, p, 0.5, "distance") for p in (0.3, 0.02))
        combined = HypothesisTest("Name", 2.0, 0.04, 0.5, "distance", parts=parts)
        assert combined.line(0.08) == (
            "Name: smallest p = 0.02, adjusted for its 2 tests p = 0.04, adjusted for all tests p = 0.08; distance 0.5"
        )
        assert repr(HypothesisTest("Name", reason="too few pairs")) == "Name: not made, too few pairs"

    def test_words(self):
        verdict = independent_and_identical(iid(np.random.default_rng(11)), significance=0.01)
        assert max(map(len, str(verdict).splitlines())) <= 100
        lines = unwrapped(verdict).splitlines()
        assert lines[0] == (
            "Are the stick durations independent and identically distributed? No evidence against it at the 1 % level."
        )
        starts = (
            "  Anderson-Darling, orders 1, 2, 3, 4, 5: p = ",
            "  Kolmogorov-Smirnov, 10 pairs of orders: smallest p = ",
            "  Spearman, orders 1 and 2: p = ",
            "  Chi-square, 5 x 5 quantile bins: p = ",
            "  Serial rank correlation, ",
            "  Used ",
            "  Each of the 300 samples gives a value of one order; ",
        )
        assert all(line.startswith(start) for line, start in zip(lines[1:], starts, strict=False))
        assert "+-" in lines[5]
        assert verdict.samples == 300
        rejected = str(independent(shared(np.random.default_rng(1)), "duration", lag=2))
        assert rejected.startswith("Are the stick durations, 2 apart, independent? Rejected at the 5 % level.\n")

    @pytest.mark.usefixtures("annotations_unchecked")
    @pytest.mark.parametrize(
        ("ask", "arguments", "named"),
        [
            (independent, {"source": 3}, "source"),
            (independent, {"source": SimpleNamespace(**{**NOTHING.columns, "start": np.zeros(2)})}, "source"),
            (independent, {"source": flat([1], np.array([np.nan]))._replace(ending=np.zeros(1))}, "source"),
            (independent, {"quantity": "position", "starts_before": math.inf}, "source"),
            (independent, {"quantity": "end"}, "quantity"),
            (independent, {"quantity": ["duration"]}, "quantity"),
            (independent, {"lag": 0}, "lag"),
            (independent, {"first": 1.5}, "first"),
            (independent, {"bins": 1}, "bins"),
            (independent, {"starts_before": math.nan}, "starts_before"),
            (independent, {"starts_before": "end"}, "starts_before"),
            (identically_distributed, {"orders": 1}, "orders"),
            (identically_distributed, {"orders": (2, 2)}, "orders"),
            (identically_distributed, {"orders": (0, 2)}, "orders"),
            (identically_distributed, {"significance": 0.0}, "significance"),
            (independent_and_identical, {"significance": 1}, "significance"),
        ],
        ids=lambda value: None if callable(value) or isinstance(value, dict) else value,
    )
    def test_bad_arguments(self, ask, arguments, named):
        with pytest.raises(ValueError, match=rf"^Argument {named}(\[0\])? must"):
            ask(**{"source": iid(np.random.default_rng(0))} | arguments)
