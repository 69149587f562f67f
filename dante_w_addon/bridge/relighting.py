"""Previews under HDRIs on their way: a Blender without a window that renders a copy of the scene; see `studio`."""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from ..blender import pictures, studio
from ..contract.protocol import Failed, Step
from .process import Process


class Relighting:
    """Renders that follow each other in a process of their own. Use as a context manager, or `close` it.

    It keeps nothing of `bpy`: whatever happens to the user's file meanwhile, there is nothing that could become invalid.

    Attributes:
        lights: the HDRI of each picture.

    Example:
        with Relighting(bpy.context, [hdris.presets()["forest"]], studio.Look()) as relighting:
            pixels = relighting.wait()
    """

    def __init__(self, context: bpy.types.Context, lights: list[Path], look: studio.Look) -> None:
        """Copy the scene and start to render.

        Raises:
            RuntimeError: that failed; one sentence says why.
        """
        self.lights = lights
        self._finished = 0
        self._reason = ""
        self._folder = Path(tempfile.mkdtemp(prefix="dante_w_", dir=bpy.app.tempdir))
        try:
            studio.write_copy(context, self._folder, lights, look)
            # Its own temporary folder lies in ours, so that nothing is left when it is killed.
            temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(self._folder))
            self._process = Process(_command(self._folder), temporary)
        except (OSError, RuntimeError) as error:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise RuntimeError(f"The preview failed: {studio.reason(error)}.") from error

    def __enter__(self) -> Relighting:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def files(self) -> list[Path]:
        """The pictures that are finished."""
        return [self._folder / f"{index}.png" for index in range(self._finished)]

    def update(self) -> bool:
        """Read what the process wrote. Returns whether it still runs."""
        code = self._process.returncode  # before the messages, so that none comes after the end
        for message in self._process.messages():
            if isinstance(message, Step):
                self._finished = int(message.step)
            elif isinstance(message, Failed):
                self._reason = message.message
        if code is not None and self._finished < len(self.lights) and not self._reason:
            self._reason = f"the Blender that renders it ended with status {code}"
        return code is None

    def pixels(self) -> np.ndarray:
        """The picture (H, W, 4), once the process has ended.

        Raises:
            RuntimeError: there is none; one sentence says why.
        """
        if self._reason:
            raise RuntimeError(f"The preview failed: {self._reason}.")
        return pictures.take_pictures(self.files, self.lights)

    def wait(self, report: Callable[[int], None] = lambda index: None) -> np.ndarray:
        """Wait for the picture, and call `report` with the index of each render that begins; raises as `pixels` does."""
        begun = 0
        while self.update():
            while begun <= min(self._finished, len(self.lights) - 1):
                report(begun)
                begun += 1
            time.sleep(0.05)
        return self.pixels()

    def close(self) -> None:
        """End what runs, and remove the files."""
        self._process.close()
        shutil.rmtree(self._folder, ignore_errors=True)


def _command(folder: Path) -> list[str]:
    """This Blender again, without the user's start-up file and add-ons; where bpy is a module, its Python."""
    script = studio.__file__
    if not bpy.app.binary_path:
        return [sys.executable, "-I", script, str(folder)]
    blender = [bpy.app.binary_path, "--background", "--factory-startup", "--python-exit-code", "1"]
    return [*blender, "--python", script, "--", str(folder)]
