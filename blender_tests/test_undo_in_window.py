"""Undo while relighting renders, in a Blender with a window: bpy as a module has none."""

import os
import shutil

import pytest
import undo_in_window

VARIABLE = "DANTEW_BLENDER_WINDOW"


def test_undo_redo_save_and_delete_while_a_window_renders(tmp_path):
    blender = os.environ.get(VARIABLE)
    if not blender:
        pytest.skip(
            f"{VARIABLE} is not set to the command that starts a Blender with a window; see window.py"
        )
    if shutil.which("Xvfb") is None:
        pytest.skip("there is no virtual screen, Xvfb")
    assert undo_in_window.run(blender, tmp_path, undos=20, seed=1) == 0
