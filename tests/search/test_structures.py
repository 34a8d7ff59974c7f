"""The random search over structures with several contacts: some 5,000, each against the event-by-event reference."""

import pytest
from support.structure_search import FAMILIES, follow, judged

EACH = 278
SOME = 2  # of every family in the search that is not slow


def test_there_are_enough():
    assert EACH * len(FAMILIES) >= 5000
    assert {family.contacts for family in FAMILIES} == set(range(2, 11))


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES, ids=str)
def test_structures(family, record_property):
    """Nothing differs but where the package tells: by its status, or its near-grazing count."""
    setups = family.drawn(EACH)
    batch = follow(setups, family.coupled)
    verdicts = [judged(setup, batch, i) for i, setup in enumerate(setups)]
    told, differ = sum(one.told for one in verdicts), sum(one.differs for one in verdicts)
    print(f"{family}: {told} of {EACH} told, {differ} differ")
    assert {i: one for i, one in enumerate(verdicts) if one.differs and not one.told} == {}
    # The comparison must not be empty.
    assert told < 0.05 * EACH
    assert batch.count.sum() > EACH
