"""Drive the panel in a real Blender window: press the buttons, wait, take screenshots.

    python3 blender_tests/drive_window.py --shots DIR --scene FOLDER --backend-python PYTHON [--standin]

It starts a virtual screen (Xvfb), Blender in it with this file as its script, and takes a screenshot
(ImageMagick's `import`) whenever the part inside Blender asks for one. The buttons are found by moving the
simulated mouse over the sidebar until Blender says that the button is under it, and pressed by simulated clicks.
FOLDER is a scene folder (a cube and plain photos are made without it); `--standin` takes the stand-in backend.
Look at the screenshots afterwards: that the script ends well says that the buttons work, not that they look right.

Where this machine has no Blender with a window, one in a Debian chroot serves, as root:

    mmdebstrap --mode=root --variant=apt --aptopt='APT::Install-Recommends "false"' \\
        --include=blender,python3-numpy,python3-requests,python3-zstandard,python3-cattr,libgl1,libegl1,libgl1-mesa-dri \\
        sid CHROOT
    mount -t proc proc CHROOT/proc; mount --bind /dev CHROOT/dev; mount --bind /tmp CHROOT/tmp
    mkdir -p CHROOT/$PWD; mount --bind $PWD CHROOT/$PWD      # the checkout, with its .venv
    mkdir -p CHROOT/BASE; mount --bind BASE CHROOT/BASE      # the Python that .venv was made with, and the scene
    python3 blender_tests/drive_window.py --shots build/shots --scene FOLDER --backend-python $PWD/.venv/bin/python \\
        --blender "chroot CHROOT env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root blender"

DIR, the checkout and FOLDER must have the same path inside and outside; hence the mounts.
"""

from __future__ import annotations

import argparse
import ast
import os
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
DISPLAY = ":97"
WIDTH, HEIGHT = 1600, 1150
PATIENCE = 900.0  # seconds for the whole drive


# ---- outside: the screen, Blender, and the screenshots -------------------------------------------------


def outside(options: argparse.Namespace) -> int:
    """Start everything, take screenshots as asked; returns Blender's exit code."""
    shots = options.shots.resolve()
    shutil.rmtree(shots / "user", ignore_errors=True)
    (shots / "user" / "config").mkdir(parents=True)
    screen = subprocess.Popen(
        ["Xvfb", DISPLAY, "-screen", "0", f"{WIDTH}x{HEIGHT}x24", "-nolisten", "tcp", "-ac"]
    )
    command = [
        *_with_variables(shlex.split(options.blender), shots / "user"),
        *("--window-geometry", "0", "0", str(WIDTH), str(HEIGHT), "--no-window-focus"),
        *("--gpu-backend", "opengl", "--enable-event-simulate", "--python-exit-code", "1"),
        *("--python", str(HERE / "drive_window.py"), "--", "--shots", str(shots)),
        *(("--scene", str(options.scene.resolve())) if options.scene else ()),
        *("--backend-python", options.backend_python, "--preset", options.preset),
        *(("--standin",) if options.standin else ()),
    ]
    try:
        time.sleep(1.0)
        blender = subprocess.Popen(command)
        end = time.monotonic() + PATIENCE
        while blender.poll() is None and time.monotonic() < end:
            for wish in shots.glob("*.wish"):
                shot = wish.with_suffix(".png")
                subprocess.run(["import", "-display", DISPLAY, "-window", "root", str(shot)], check=True)
                wish.unlink()
            time.sleep(0.1)
        if blender.poll() is None:
            blender.kill()
            print("the drive took too long", file=sys.stderr)
            return 1
        return blender.returncode
    finally:
        screen.terminate()
        screen.wait()


def _with_variables(command: list[str], user: Path) -> list[str]:
    """The command, with its variables set by `env` just before Blender, so that a chroot passes them on."""
    variables = [f"DISPLAY={DISPLAY}", "LIBGL_ALWAYS_SOFTWARE=1", f"BLENDER_USER_RESOURCES={user}"]
    return [*command[:-1], "env", *variables, command[-1]]


# ---- inside Blender --------------------------------------------------------------------------------------


class Driver:
    """Moves the mouse, presses buttons, asks for screenshots. Its methods are generators of waits."""

    def __init__(self, shots: Path) -> None:
        self.shots = shots

    @property
    def window(self):
        return bpy.context.window_manager.windows[0]

    @property
    def view(self):
        return next(area for area in self.window.screen.areas if area.type == "VIEW_3D")

    @property
    def sidebar(self):
        return next(region for region in self.view.regions if region.type == "UI")

    def open_tab(self):
        """Show the DANTE-W tab; the category can be set only once it has been drawn."""
        self.view.spaces.active.show_region_ui = True
        for _ in range(50):
            yield 0.1
            try:
                self.sidebar.active_panel_category = "DANTE-W"
            except (AttributeError, TypeError):
                continue
            if self.sidebar.active_panel_category == "DANTE-W":
                return
        raise RuntimeError("the DANTE-W tab did not open")

    def widen(self, pixels):
        """Drag the sidebar's edge, as a user would."""
        x, y = self.sidebar.x + 1, self.sidebar.y + self.sidebar.height // 3
        yield from self.move(x, y)
        self.event("LEFTMOUSE", "PRESS", x, y)
        for step in range(1, 11):
            yield 0.05
            self.event("MOUSEMOVE", "NOTHING", x - pixels * step // 10, y)
        yield 0.1
        self.event("LEFTMOUSE", "RELEASE", x - pixels, y)
        yield 0.5

    def find(self, operator, **values):
        """Where the button of `operator` with these properties is: sweeps the mouse over the sidebar."""
        region = self.sidebar
        for x in (region.x + region.width // 4, region.x + 5 * region.width // 8):
            for y in range(region.y + region.height - 10, region.y + 4, -12):
                yield from self.move(x, y, 0.03)
                if self.is_over(operator, values):
                    return x, y - 2
        raise RuntimeError(f"no button for {operator} {values}")

    def is_over(self, operator, values):
        """Whether the button under the mouse is this one: Blender copies its command to the clipboard."""
        manager = bpy.context.window_manager
        manager.clipboard = ""
        with bpy.context.temp_override(window=self.window, area=self.view, region=self.sidebar):
            if bpy.ops.ui.copy_python_command_button.poll():
                bpy.ops.ui.copy_python_command_button()
        if not manager.clipboard.startswith(f"bpy.ops.dantew.{operator}("):
            return False
        said = {word.arg: ast.literal_eval(word.value) for word in _call(manager.clipboard).keywords}
        properties = getattr(bpy.ops.dantew, operator).get_rna_type().properties
        return all(said.get(name, properties[name].default) == value for name, value in values.items())

    def press(self, operator, **values):
        """Click the button of `operator`."""
        x, y = yield from self.find(operator, **values)
        yield from self.click(x, y)
        print(f"pressed {operator} {values or ''} at {x}, {y}", flush=True)

    def click(self, x, y):
        """Click there, as a user would."""
        yield from self.move(x, y, 0.3)
        self.event("LEFTMOUSE", "PRESS", x, y)
        yield 0.1
        self.event("LEFTMOUSE", "RELEASE", x, y)
        yield 0.3

    def pick_known_colours(self, name):
        """Open the sub-panel, whose header is the line above Recover, and pick two spots on the mesh."""

        def spots():  # undo makes former references invalid
            return bpy.data.objects[name].dante_w_known_colours

        x, y = yield from self.find("recover")
        yield from self.click(x, y + 22)
        middle = self.view.x + (self.sidebar.x - self.view.x) // 2, self.view.y + self.view.height // 2
        yield from self.press("pick_known_colour")
        yield from self.click(self.view.x + 100, self.view.y + 20)  # beside the mesh
        assert not spots()
        yield from self.shot("picking")
        yield from self.click(*middle)
        assert len(spots()) == 1
        for step, expected in ((bpy.ops.ed.undo, 0), (bpy.ops.ed.redo, 1)):
            with bpy.context.temp_override(window=self.window):
                step()
            yield 0.5
            assert len(spots()) == expected
        yield from self.press("pick_known_colour")
        self.event("ESC", "PRESS", *middle)
        yield 0.3
        assert len(spots()) == 1
        yield from self.press("pick_known_colour")
        yield from self.click(middle[0] - 150, middle[1] + 200)
        spot = spots()[1]
        spot.grey, spot.colour = False, (0.7, 0.4, 0.2)
        yield from self.rest()

    def move(self, x, y, seconds=0.1):
        self.event("MOUSEMOVE", "NOTHING", x, y)
        yield seconds

    def event(self, kind, value, x, y):
        self.window.event_simulate(type=kind, value=value, x=int(x), y=int(y))

    def rest(self):
        """Move the mouse where it highlights nothing."""
        yield from self.move(self.view.x + 300, self.view.y + 200, 0.6)

    def shot(self, name):
        """Ask for a screenshot, and wait until it is taken."""
        self.view.tag_redraw()
        yield 0.6
        wish = self.shots / f"{name}.wish"
        wish.write_text("")
        while wish.exists():
            yield 0.1

    def wait_for(self, done, seconds, what):
        end = time.monotonic() + seconds
        while not done():
            if time.monotonic() > end:
                raise RuntimeError(f"{what} did not happen in {seconds:.0f} s")
            yield 0.1


def _call(command):
    return ast.parse(command.strip(), mode="eval").body


def story(options: argparse.Namespace):
    """What the user does."""
    import small_scene

    from dante_w_addon import layout
    from dante_w_addon.blender import material
    from dante_w_addon.bridge import job
    from dante_w_addon.operators import relight

    driver = Driver(options.shots)
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


def inside(options: argparse.Namespace) -> None:
    """Register the add-on, and tell the story from a timer, one wait at a time."""
    sys.path[:0] = [str(ROOT), str(HERE)]
    import dante_w_addon

    view = bpy.context.preferences.view
    view.show_splash = False
    view.show_statusbar_stats = False
    bpy.context.preferences.use_preferences_save = False
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    dante_w_addon.register()
    steps = story(options)

    def step():
        try:
            return next(steps)
        except StopIteration:
            print("driven to the end", flush=True)
            code = 0
        except Exception:
            import traceback

            traceback.print_exc()
            (options.shots / "failed.wish").write_text("")
            time.sleep(1.0)
            code = 1
        dante_w_addon.unregister()
        os._exit(code)  # without the question whether to save

    bpy.app.timers.register(step, first_interval=1.0)


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


try:
    import bpy
except ImportError:
    bpy = None

if __name__ == "__main__":
    if bpy is None:
        sys.exit(outside(parse(sys.argv[1:])))
    inside(parse(sys.argv[sys.argv.index("--") + 1 :]))
