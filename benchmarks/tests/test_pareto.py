"""The Pareto front against its definition, and the table."""

from __future__ import annotations

import numpy as np
import pytest
from measure.pareto import PRESET, Row, pareto_front, table


def by_definition(seconds: np.ndarray, accuracy: np.ndarray) -> list[bool]:
    points = list(zip(seconds, accuracy, strict=True))
    return [not any(s <= t and a >= b and (s, a) != (t, b) for s, a in points) for t, b in points]


@pytest.mark.parametrize("seed", range(60))
@pytest.mark.parametrize("values", [3, 8, 1000])
def test_front_is_what_nothing_beats(seed, values):
    """Few values make many ties."""
    random = np.random.default_rng(seed)
    seconds, accuracy = random.integers(0, values, (2, random.integers(1, 40))).astype(float)
    front = pareto_front(seconds, accuracy)
    assert front.tolist() == by_definition(seconds, accuracy)
    assert front.any()
    shuffled = random.permutation(len(seconds))
    assert (pareto_front(seconds[shuffled], accuracy[shuffled]) == front[shuffled]).all()


def test_equal_points_stand_together():
    assert pareto_front(np.ones(3), np.ones(3)).all()
    front = pareto_front(np.array([1.0, 2.0, 2.0]), np.array([5.0, 4.0, 4.0]))
    assert front.tolist() == [True, False, False]


def test_front_takes_nothing_and_infinities():
    assert pareto_front(np.zeros(0), np.zeros(0)).shape == (0,)
    assert pareto_front(np.array([1.0, 2.0]), np.array([-np.inf, np.inf])).all()


def test_nan_is_refused():
    with pytest.raises(ValueError, match="NaN"):
        pareto_front(np.array([1.0, np.nan]), np.zeros(2))


def test_table_compares_with_the_base():
    rows = [
        Row(PRESET, "draft", 13.0, 6.0, 18.0, 23.5),
        Row(PRESET, "standard", 40.0, 30.0, 19.0, 24.9),
        Row("steps", "1000", 70.0, 60.0, 19.2, 25.25),
    ]
    lines = table(rows, np.array([True, False, True]), np.array([True, True, True]), "standard").splitlines()
    assert lines[2] == "| preset | draft | 13.0 | 6.0 | 18.00 | 23.50 | -27.0 | -1.40 | yes |"
    assert lines[3].endswith("| +0.0 | +0.00 | but for chance |")
    assert lines[4] == "| steps | 1000 | 70.0 | 60.0 | 19.20 | 25.25 | +30.0 | +0.35 | yes |"
    assert len({line.count("|") for line in lines}) == 1
