"""The benchmark of many photos: its tables, and what it sees of a process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from draft import LAGRANGE, Times, table, timed
from many_photos import GIB, Run, arithmetic, run_table, stage_table, watched
from measure.synthetic_scene import bumpy_sphere, write_photos


def run_of(photos: int, model: str = "traced light") -> Run:
    return Run(
        photos,
        model,
        "draft",
        photos * 1000,
        {"rays": 2.0, "albedo": 1.0, "lights": 7.0},
        10.0,
        {"rays": int(GIB), "lights": int(2 * GIB)},
        {"rays": int(3 * GIB)},
        photos * 17_000,
        None,
    )


def test_full_size_costs_what_grows_with_pixels() -> None:
    text = arithmetic([run_of(250), run_of(2500)], 1000)  # 24 times the pixels
    row = text.splitlines()[-1]
    # 2.5 million samples times 24 times 17 bytes; 10 s and 23 times 3 s
    assert row == "| traced light | `draft` | 2500 | 0.1 | 1 | 0.0 |"
    assert text.count("| traced light |") == 1


def test_tables_have_a_row_a_run_and_gaps_where_a_model_has_no_stage() -> None:
    runs = [run_of(2500), run_of(250), run_of(250, "the paper's model")]
    rows = run_table(runs).splitlines()[2:]
    assert [row.split("|")[3].strip() for row in rows] == ["250", "2500", "250"]
    assert "| 2.00 | 3.00 |" in rows[0]
    runs[1].anonymous["albedo"] = int(GIB)
    assert stage_table(runs).splitlines()[2].endswith("| 1.00 | 2.00 | 1.00 |")
    assert stage_table(runs).splitlines()[3].endswith("| 1.00 | 2.00 |  |")


def test_memory_is_noted_by_stage(tmp_path: Path) -> None:
    work = "import sys; held = bytearray(b'x' * (200 << 20)); print('up', flush=True); sys.stdin.read()"
    process = subprocess.Popen(
        [sys.executable, "-c", work], stdin=subprocess.PIPE, stdout=subprocess.PIPE, encoding="utf-8"
    )
    folder = tmp_path / ".staging" / "rays"
    folder.mkdir(parents=True)
    (folder / "face").write_bytes(b"12345")
    assert process.stdin and process.stdout
    process.stdout.readline()
    stage = ["first"]
    with watched(process.pid, stage, tmp_path / "result") as (anonymous, resident, files):
        while "first" not in anonymous:
            pass
        stage[0] = "second"
        while "second" not in resident:
            pass
    process.stdin.close()
    process.wait()
    assert anonymous["first"] > 200 << 20 and resident["second"] >= anonymous["second"] > 200 << 20
    assert max(files) == 5


def test_photos_take_lights_at_random(tmp_path: Path) -> None:
    mesh = bumpy_sphere(12)
    frames = write_photos(tmp_path, mesh, 8, 3, lights=2)
    assert len({frame.image for frame in frames}) == 3 and all(frame.image.is_file() for frame in frames)


def test_the_yardstick_is_the_clock() -> None:
    times = {"`draft`": Times([4.0, 2.0, 2.0], [1.0, 1.0, 9.0]), LAGRANGE: Times([5.0], [8.0])}
    rows = table(times, "bust", 64).splitlines()
    assert rows[2] == "| `draft` | 2.0 | 1.0 | 2.50 |" and rows[3] == f"| {LAGRANGE} | 5.0 | 8.0 | 1.00 |"


def test_processor_seconds_are_the_childs() -> None:
    work = "import time\nbegan = time.process_time()\nwhile time.process_time() - began < 0.3: pass"
    clock, processor = timed([sys.executable, "-c", work])
    assert 0.3 <= processor < 0.3 + clock * (os.cpu_count() or 1)
    with pytest.raises(SystemExit):
        timed([sys.executable, "-c", "raise SystemExit(3)"])
