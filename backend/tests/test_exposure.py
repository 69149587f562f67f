"""Exposures from photos' files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from dante_w.contract.scene_folder import Frame
from dante_w.scene.exposure import relative_log_exposures
from dante_w.scene.images import read_header
from square_scene import CAMERA

NAMES = ("ExposureTime", "FNumber", "Exif:PhotographicSensitivity")


def photo(file: Path, *values: float | None) -> Path:
    """A black picture that notes time, f-number and sensitivity, where these are given."""
    spec = oiio.ImageSpec(8, 6, 3, "uint8")
    for name, value in zip(NAMES, values, strict=False):
        if value is not None:
            spec.attribute(name, value)
    out = oiio.ImageOutput.create(str(file))
    assert out.open(str(file), spec) and out.write_image(np.zeros((6, 8, 3), np.uint8)) and out.close()
    return file


def log_exposures(files: list[Path]) -> np.ndarray | None:
    frames = [Frame(file, CAMERA, np.eye(4), log_exposure=read_header(file).log_exposure) for file in files]
    return relative_log_exposures(frames)


@pytest.mark.parametrize("kind", ["jpg", "png"])
def test_exposures_are_relative_logs(tmp_path, kind):
    settings = [(0.01, 4.0, 200), (0.02, 4.0, 200), (0.01, 8.0, 200), (0.01, 4.0, 400)]
    found = log_exposures([photo(tmp_path / f"{i}.{kind}", *each) for i, each in enumerate(settings)])
    assert found is not None
    wanted = np.log([1.0, 2.0, 0.25, 2.0])
    np.testing.assert_allclose(found, wanted - wanted.mean(), atol=1e-3)


@pytest.mark.parametrize(
    "values", [(), (None, 4.0, 200), (0.01, None, 200), (0.01, 4.0), (0.0, 4.0, 200), (0.01, 4.0, 0)]
)
def test_one_file_that_does_not_tell_all_spoils_it(tmp_path, values):
    whole = photo(tmp_path / "a.jpg", 0.01, 4.0, 200)
    assert log_exposures([whole, whole]) is not None
    assert log_exposures([whole, photo(tmp_path / "b.jpg", *values)]) is None


def test_a_frame_whose_header_was_not_read_has_none():
    assert relative_log_exposures([Frame(Path("a.jpg"), CAMERA, np.eye(4))]) is None
