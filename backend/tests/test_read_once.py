"""What a run does once alone, as it is dear: the mesh's BVH."""

from __future__ import annotations

from pathlib import Path

import pytest
from dante_w.commands.cli import main
from dante_w.rays.raycast import Raycaster


def test_a_run_builds_one_bvh(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built = []
    build = Raycaster.__init__
    monkeypatch.setattr(Raycaster, "__init__", lambda self, *arguments: built.append(build(self, *arguments)))
    options = ["--preset", "draft", "--texture-size", "64", "--unwrap", "--model", "sun"]
    assert main(["recover", str(scene), "--out", str(tmp_path / "out"), *options]) == 0
    assert len(built) == 1
