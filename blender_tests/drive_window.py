"""Drive the panel in a real Blender window: press the buttons, wait, take screenshots.

    python3 blender_tests/drive_window.py --shots DIR --scene FOLDER --backend-python PYTHON [--standin]

FOLDER is a scene folder (a cube and plain photos are made without it); `--standin` takes the stand-in backend.
Look at the screenshots afterwards: that the script ends well says that the buttons work, not that they look right.
window.py says what it needs.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import window  # noqa: E402

try:
    import bpy
except ImportError:
    bpy = None


def story(driver: window.Driver, options: argparse.Namespace):
    """What the user does."""
    import small_scene

    from dante_w_addon import layout
    from dante_w_addon.blender import material
    from dante_w_addon.bridge import job
    from dante_w_addon.operators import relight

    if options.standin:
        layout.launcher = lambda: HERE / "standin" / "launch.py"
        os.environ["STANDIN_STEPS"] = "600"
    os.environ["DANTEW_BACKEND_PYTHON"] = options.backend_python
    yield 1.0
    yield from driver.open_tab()
    yield from driver.widen(130)
    yield from driver.rest()
    yield from driver.shot("panel-empty")

    if options.scene:
        with bpy.context.temp_override(window=driver.window):
            bpy.ops.dantew.import_scene(filepath=str(options.scene))
    else:
        small_scene.build(options.shots / "photos")
    obj = next(obj for obj in bpy.context.scene.objects if obj.type == "MESH")
    name = obj.name
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    settings = bpy.context.scene.dante_w
    settings.preset, settings.output_folder = options.preset, str(options.shots / "runs")
    settings.samples = 16
    space = driver.view.spaces.active
    space.overlay.show_extras = True
    with bpy.context.temp_override(
        window=driver.window,
        area=driver.view,
        region=next(r for r in driver.view.regions if r.type == "WINDOW"),
    ):
        bpy.ops.view3d.view_selected()
        bpy.ops.ed.undo_push(message="Scene")  # what a script does is no undo step by itself
    yield 1.0
    yield from driver.rest()
    yield from driver.shot("panel-source")

    yield from driver.pick_known_colours(name)
    obj = bpy.data.objects[name]
    yield from driver.shot("panel-known-colours")

    yield from driver.press("recover")
    yield from driver.wait_for(lambda: job.recovering() and job.recovery.progress.plan, 300.0, "planned")
    yield 1.0
    yield from driver.rest()
    yield from driver.shot("panel-running")
    yield from driver.press("cancel")
    before = time.monotonic()
    yield from driver.wait_for(lambda: not job.recovering(), 2.0, "cancelling")
    print(f"cancelled after {time.monotonic() - before:.2f} s", flush=True)
    yield from driver.rest()
    yield from driver.shot("panel-cancelled")

    os.environ["STANDIN_STEPS"] = "20"
    yield from driver.press("recover")
    yield from driver.wait_for(lambda: not job.recovering(), 600.0, "the recovery")
    assert job.recovery.progress.state == "done", job.recovery.progress.message
    assert material.display_of(obj) == "ALBEDO"
    space.shading.type = "MATERIAL"
    yield 15.0  # shaders compile
    yield from driver.rest()
    yield from driver.shot("panel-result")
    for step, expected in ((bpy.ops.ed.undo, False), (bpy.ops.ed.redo, True)):
        with bpy.context.temp_override(window=driver.window):
            step()
        yield 0.5
        obj = bpy.data.objects[name]  # undo makes former references invalid
        assert (material.display_of(obj) == "ALBEDO") == expected, (
            "one undo takes the albedo back, redo restores it"
        )
    space = driver.view.spaces.active
    space.shading.type = "SOLID"  # quicker to redraw without a GPU
    space.shading.color_type = "TEXTURE"
    yield from driver.press("show", which="ORIGINAL")
    assert material.display_of(obj) == "ORIGINAL"
    yield from driver.press("show", which="ALBEDO")
    assert material.display_of(obj) == "ALBEDO"

    yield from driver.press("relight", every=False)
    assert relight.active is not None, "the preview did not start"
    yield from driver.wait_for(lambda: relight.active is None, 300.0, "the preview")
    assert bpy.data.images.get(relight.PREVIEW), relight.last_message
    space.shading.type = "MATERIAL"
    yield 3.0
    yield from driver.rest()
    yield from driver.shot("panel-relight")
    space.shading.type = "SOLID"
    yield from driver.press("relight", every=True)
    yield from driver.wait_for(lambda: len(relight.active.files) == 2, 300.0, "two tiles")
    yield from driver.rest()
    yield from driver.shot("panel-sheet-running")
    yield from driver.wait_for(lambda: relight.active is None, 300.0, "the contact sheet")
    yield from driver.rest()
    yield from driver.shot("panel-sheet")
    assert [scene.name for scene in bpy.data.scenes] == ["Scene"], "the borrowed scene was left behind"
    yield from driver.press("open_image", name=relight.SHEET)
    yield 2.0
    yield from driver.shot("sheet-window")
    bpy.ops.wm.save_as_mainfile(filepath=str(options.shots / "driven.blend"))


def parse(arguments: list[str]) -> argparse.Namespace:
    """The same options outside and inside."""
    parser = argparse.ArgumentParser(description="Drive the panel in a real Blender window.")
    parser.add_argument("--shots", type=Path, required=True, help="folder for screenshots and runs")
    parser.add_argument("--scene", type=Path, help="scene folder or transforms file")
    parser.add_argument("--backend-python", required=True)
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--standin", action="store_true", help="use the stand-in backend")
    parser.add_argument("--blender", default="blender", help="command that starts Blender")
    return parser.parse_args(arguments)


def arguments(options: argparse.Namespace) -> list[str]:
    """`options` again, for the part inside Blender, whose working folder is another."""
    scene = ("--scene", str(options.scene.resolve())) if options.scene else ()
    standin = ("--standin",) if options.standin else ()
    backend = ("--backend-python", options.backend_python, "--preset", options.preset)
    return ["--shots", str(options.shots.resolve()), *scene, *backend, *standin]


if __name__ == "__main__":
    if bpy is None:
        given = parse(sys.argv[1:])
        sys.exit(window.outside(given.blender, given.shots, "drive_window.py", arguments(given)))
    given = parse(sys.argv[sys.argv.index("--") + 1 :])
    window.inside(lambda driver: story(driver, given), given.shots)
