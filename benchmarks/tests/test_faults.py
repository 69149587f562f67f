"""What provokes faults is itself what it says, and tells a fault that is not handled."""

from __future__ import annotations

import json
import random
import sys
import zlib

import pytest
from extremes import fuzz
from extremes.broken_files import zeros
from extremes.provoke import Ended, Stand, ended, judged


def test_a_stream_of_zeros_is_one():
    for count in (0, 5, 65521, 3 << 20):
        assert zlib.decompress(zeros(count)) == bytes(count)


@pytest.mark.parametrize("name", fuzz.READERS)
def test_inputs_are_the_same_each_time_and_some_are_valid(name, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["fuzz.py", name, "0", "60"])
    said = []
    for _ in range(2):
        fuzz.main()
        said.append(json.loads(capsys.readouterr().out))
    assert [each["refused"] for each in said] == [said[0]["refused"]] * 2
    assert said[0]["valid"] > 0 and said[0]["refused"] > 0 and not said[0]["wrong"]


def test_what_a_reader_must_not_do_is_told(monkeypatch, capsys):
    def read(folder, rng: random.Random) -> None:
        raise KeyError("x")

    monkeypatch.setitem(fuzz.READERS, "bad", read)
    monkeypatch.setattr(sys, "argv", ["fuzz.py", "bad", "0", "2"])
    fuzz.main()
    assert len(json.loads(capsys.readouterr().out)["wrong"]) == 2


def test_a_process_that_breaks_off_is_told(tmp_path, monkeypatch):
    (tmp_path / "aborts.py").write_text("import os; os.abort()")
    monkeypatch.setattr(fuzz, "__file__", str(tmp_path / "aborts.py"))
    verdict = fuzz.judged("OBJ", 0, 5)
    assert verdict["valid"] == verdict["refused"] == 0 and "ended the process" in verdict["wrong"][0]


@pytest.fixture
def place(tmp_path):
    (tmp_path / "former").mkdir()
    (tmp_path / "former" / "albedo.png").write_text("former")
    stand = Stand(tmp_path)
    stand.fresh()
    return stand


GOOD = ended(4, '{"stage": "error", "code": 4, "message": "The disk is full; free some space."}')


def test_a_fault_well_handled_holds(place):
    assert judged("x", 4, GOOD, place, "full").holds


@pytest.mark.parametrize(
    ("found", "left"),
    [
        (Ended(1, GOOD.events, ""), ""),
        (Ended(4, [], ""), ""),
        (Ended(4, GOOD.events, "Traceback (most recent call last):"), ""),
        (GOOD, ".partial"),
        (GOOD, "albedo.png"),
    ],
)
def test_a_fault_ill_handled_does_not(place, found, left):
    if left:
        (place.out / left).write_text("changed")
    assert not judged("x", 4, found, place, "full").holds
