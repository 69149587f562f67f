"""The scaling benchmark reads runs and exponents rightly."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scaling
from measure.pictures import read
from measure.synthetic_scene import bumpy_sphere, write_photos
from scaling import END, MEMORY, TOTAL, Run, Shape, exponent, exponents

DRAFT = argparse.Namespace(irradiance="field", preset="draft")


def run_of(size: float, rays: float, bake: float) -> Run:
    return Run(
        Shape("photos", size), 1000, {"rays": rays, "bake": bake, TOTAL: rays + bake}, int(1e9 * size), 0
    )


def test_the_exponent_is_that_of_the_larger_half() -> None:
    sizes = [4.0, 1.0, 2.0, 8.0, 16.0]  # in any order
    values = [3.0 * size**1.5 if size >= 4.0 else 100.0 for size in sizes]
    assert exponent(sizes, values) == pytest.approx(1.5)
    assert exponent([1.0, 10.0], [2.0, 20.0]) == pytest.approx(1.0)


def test_stages_that_take_no_time_have_no_exponent() -> None:
    found = exponents([run_of(1, 0.5, 0.01), run_of(4, 2.0, 0.02), run_of(16, 8.0, 0.01)])
    assert found == {"photos": {"rays": 1.0, TOTAL: pytest.approx(1.0, abs=0.02), MEMORY: 1.0}}


def test_the_ladders_grow_in_one_way_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "sys.argv", ["scaling.py", "--photos", "3", "--megapixels", "4", "--texture-sizes", "1000"]
    )
    photos, pixels, texels = scaling.shapes(scaling.parse())
    assert (photos.size, photos.photos, photos.photo_side, photos.texture_side) == (3, 3, 512, 2048)
    assert (pixels.size, pixels.photos, pixels.photo_side, pixels.texture_side) == (4.0, 8, 2000, 2048)
    assert (texels.size, texels.photos, texels.photo_side, texels.texture_side) == (1.0, 8, 512, 1000)


def test_a_run_counts_all_seconds_and_the_cache_on_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def product(arguments: list[str], out: Path) -> tuple[dict[str, Any], float]:
        assert arguments[2:] == ["--irradiance", "field", "--preset", "draft", "--texture-size", "64"]
        rays = out / ".partial" / "rays"
        rays.mkdir(parents=True)
        (rays / "face").write_bytes(bytes(300))
        (rays / "bary").write_bytes(bytes(100))
        looked.clear()
        assert looked.wait(10.0)
        return {"samples": 7, "seconds": {"rays": 2.0, "bake": 1.0}, "peak_memory_bytes": 5}, 3.5

    looked = scaling.threading.Event()
    total = sum
    monkeypatch.setattr(scaling, "sum", lambda values: looked.set() or total(values), raising=False)
    monkeypatch.setattr(scaling, "dante_w", product)
    monkeypatch.setattr(scaling, "LOOK_SECONDS", 0.01)
    mesh = bumpy_sphere(4)
    frames = write_photos(tmp_path / "scene", mesh, 8, 1)
    shape = Shape("photos", 2, photos=2, photo_side=8, texture_side=64)
    run = scaling.recover(shape, DRAFT, tmp_path / "scene", mesh, frames, tmp_path / "result")
    assert run.seconds == {"rays": 2.0, "bake": 1.0, END: 0.5, TOTAL: 3.5}
    assert (run.samples, run.peak_memory_bytes, run.cache_file_bytes) == (7, 5, 400)


@pytest.mark.slow
@pytest.mark.parametrize("irradiance", ["traced", "field"])
def test_the_product_runs_on_the_scene(tmp_path: Path, irradiance: str) -> None:
    mesh = bumpy_sphere(8)
    frames = write_photos(tmp_path / "scene", mesh, 48, 2)
    shape = Shape("photos", 5, photos=5, photo_side=48, texture_side=64)
    options = argparse.Namespace(irradiance=irradiance, preset="draft")
    run = scaling.recover(shape, options, tmp_path / "scene", mesh, frames, tmp_path / "result")
    assert list(run.seconds) == [*scaling.stages([run]), TOTAL]
    assert ("lights" in run.seconds) == (irradiance == "traced")
    assert 0 < run.samples < 5 * 48 * 48
    assert run.seconds[END] > 0.0


def test_tables_and_figure_show_every_run(tmp_path: Path) -> None:
    runs = [run_of(size, 0.5 * size, 0.3) for size in (1, 4, 16)]
    lines = scaling.run_table(runs).splitlines()
    assert len(lines) == 2 + 3
    assert len({line.count("|") for line in lines}) == 1
    assert lines[0].startswith("| grows | size | samples (M) | rays | bake | all |")
    assert "| photos | 1.00 |" in scaling.exponent_table(runs)
    file = tmp_path / "figure.png"
    scaling.draw(file, runs)
    picture, _ = read(file)
    assert file.stat().st_size < 300_000
    assert np.mean(picture < 0.5) > 0.005  # something is drawn
