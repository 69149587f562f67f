"""A real Blender window for scripts: a virtual screen, screenshots, and a user made of simulated events.

`outside` starts a virtual screen (Xvfb) and Blender in it with a script of this folder, and takes a screenshot
(ImageMagick's `import`) whenever the part inside Blender asks for one. `inside` tells a story there, a generator that
yields the seconds to wait. `Driver` finds buttons by moving the simulated mouse over the sidebar until Blender says that
the button is under it, and presses them by simulated clicks.

Where this machine has no Blender with a window, one in a Debian chroot serves, as root:

    mmdebstrap --mode=root --variant=apt --aptopt='APT::Install-Recommends "false"' \\
        --include=blender,python3-numpy,python3-requests,python3-zstandard,python3-cattr,libgl1,libegl1,libgl1-mesa-dri \\
        sid CHROOT
    mount -t proc proc CHROOT/proc; mount --bind /dev CHROOT/dev; mount --bind /tmp CHROOT/tmp
    mkdir -p CHROOT/$PWD; mount --bind $PWD CHROOT/$PWD      # the checkout, with its .venv
    mkdir -p CHROOT/BASE; mount --bind BASE CHROOT/BASE      # the Python that .venv was made with, and the scene
    python3 blender_tests/drive_window.py --shots build/shots --scene FOLDER --backend-python $PWD/.venv/bin/python \\
        --blender "chroot CHROOT env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root blender"

The folder of screenshots, the checkout and FOLDER must have the same path inside and outside; hence the mounts.
"""

from __future__ import annotations

import ast
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
WIDTH, HEIGHT = 1600, 1150
PATIENCE = 900.0  # seconds for the whole drive

try:
    import bpy
except ImportError:
    bpy = None


# ---- outside: the screen, Blender, and the screenshots -------------------------------------------------


def outside(blender: str, shots: Path, script: str, arguments: Sequence[str]) -> int:
    """Start everything, take screenshots as asked; returns Blender's exit code.

    Args:
        blender: the command that starts Blender.
        shots: folder for screenshots and whatever else the script writes.
        script: name of a script beside this file, run inside Blender.
        arguments: the script's.
    """
    shots = shots.resolve()
    shutil.rmtree(shots / "user", ignore_errors=True)
    (shots / "user" / "config").mkdir(parents=True)
    screen, display = _screen()
    try:
        command = [
            *_with_variables(shlex.split(blender), display, shots / "user"),
            *("--window-geometry", "0", "0", str(WIDTH), str(HEIGHT), "--no-window-focus"),
            *("--gpu-backend", "opengl", "--enable-event-simulate", "--python-exit-code", "1"),
            *("--python", str(HERE / script), "--", *arguments),
        ]
        process = subprocess.Popen(command)
        end = time.monotonic() + PATIENCE
        while process.poll() is None and time.monotonic() < end:
            for wish in shots.glob("*.wish"):
                shot = wish.with_suffix(".png")
                subprocess.run(["import", "-display", display, "-window", "root", str(shot)], check=True)
                wish.unlink()
            time.sleep(0.1)
        if process.poll() is None:
            process.kill()
            print("the drive took too long", file=sys.stderr)
            return 1
        return process.returncode
    finally:
        screen.terminate()
        screen.wait()


def _screen() -> tuple[subprocess.Popen, str]:
    """Start a virtual screen on a free display; returns its process and the display's name."""
    reading, writing = os.pipe()
    size = ("-screen", "0", f"{WIDTH}x{HEIGHT}x24")
    command = ["Xvfb", "-displayfd", str(writing), *size, "-nolisten", "tcp", "-ac"]
    screen = subprocess.Popen(command, pass_fds=(writing,))
    os.close(writing)
    with os.fdopen(reading) as number:  # written once the screen is ready
        return screen, f":{number.readline().strip()}"


def _with_variables(command: list[str], display: str, user: Path) -> list[str]:
    """The command, with its variables set by `env` just before Blender, so that a chroot passes them on."""
    variables = [f"DISPLAY={display}", "LIBGL_ALWAYS_SOFTWARE=1", f"BLENDER_USER_RESOURCES={user}"]
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


def inside(story: Callable[[Driver], Iterator[float]], shots: Path) -> None:
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
    steps = story(Driver(shots))

    def step():
        try:
            return next(steps)
        except StopIteration:
            print("driven to the end", flush=True)
            code = 0
        except Exception:
            import traceback

            traceback.print_exc()
            (shots / "failed.wish").write_text("")
            time.sleep(1.0)
            code = 1
        dante_w_addon.unregister()
        os._exit(code)  # without the question whether to save

    bpy.app.timers.register(step, first_interval=1.0)
