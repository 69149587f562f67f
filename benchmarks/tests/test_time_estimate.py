"""The comparison of expected and actual seconds."""

import pytest
from time_estimate import Row, compare, error, table

REPORT = {
    "expected": {"seconds": {"start": 2.0, "rays": 3.0, "final pass": 1.0}, "total_seconds": 6.0},
    "seconds": {"start": 2.0, "rays": 4.0, "write": 0.5},
}


def test_error_is_relative_to_what_it_took():
    assert error(13.0, 10.0) == pytest.approx(30.0)
    assert error(7.0, 10.0) == pytest.approx(-30.0)


def test_total_is_the_command_and_a_missing_stage_is_an_error_of_its_own():
    row = compare("apple", "draft", REPORT, 8.0)
    assert row.total == (6.0, 8.0)
    assert row.stages == {
        "start": (2.0, 2.0),
        "rays": (3.0, 4.0),
        "final pass": (1.0, 0.0),
        "write": (0.0, 0.5),
    }


def test_table_has_a_column_for_every_stage_of_any_row():
    rows = [compare("apple", "draft", REPORT, 8.0), Row("box", "high", {"bake": (1.0, 2.0)}, (1.0, 2.0))]
    head, _, first, second = table(rows).splitlines()
    assert head.split(" | ")[2:] == ["total", "start", "rays", "final pass", "write", "bake |"]
    assert "6.0 / 8.0 (-25%)" in first and "1.0 / 2.0 (-50%)" in second
    assert {line.count("|") for line in (head, first, second)} == {9}
