"""What a run does once alone, as it is dear: build the mesh's BVH, and open each photo for its header."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import OpenImageIO as oiio  # noqa: N813
import pytest
from dante_w.commands.cli import main
from dante_w.rays.raycast import Raycaster


class CountingInput:
    """`oiio.ImageInput` that counts, by the file's name, how often a photo is opened and how often its pixels are read."""

    opened: Counter[str]
    decoded: Counter[str]

    def __init__(self, name: str, source: Any) -> None:
        self._name, self._source = name, source

    @classmethod
    def open(cls, path: str, *config: Any) -> CountingInput:
        name = Path(path).name
        cls.opened[name] += 1
        return cls(name, oiio_open(path, *config))

    def read_image(self, kind: Any) -> Any:
        self.decoded[self._name] += 1
        return self._source.read_image(kind)

    def __getattr__(self, attribute: str) -> Any:
        return getattr(self._source, attribute)


oiio_open = oiio.ImageInput.open


def test_a_run_builds_one_bvh_and_reads_each_header_once(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bvhs = []
    build = Raycaster.__init__
    monkeypatch.setattr(Raycaster, "__init__", lambda self, *arguments: bvhs.append(build(self, *arguments)))
    CountingInput.opened, CountingInput.decoded = Counter(), Counter()
    monkeypatch.setattr(oiio, "ImageInput", CountingInput)
    options = ["--preset", "draft", "--texture-size", "64", "--unwrap", "--model", "sun"]
    assert main(["recover", str(scene), "--out", str(tmp_path / "out"), *options]) == 0
    assert len(bvhs) == 1
    for photo in [f"{index}.png" for index in range(8)]:
        assert CountingInput.opened[photo] - CountingInput.decoded[photo] == 1  # the header
        assert CountingInput.decoded[photo] == 1  # for the rays
