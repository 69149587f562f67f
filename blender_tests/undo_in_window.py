"""Press Ctrl+Z, Ctrl+Shift+Z and Ctrl+S, and delete objects, at random moments while relighting renders in a window.

    python3 blender_tests/undo_in_window.py --shots DIR [--undos N] [--seed N] [--blender COMMAND]

The keys are simulated, as a user would press them; nothing of Blender's undo can be tried without a window. It ends well when
Blender lives, every picture arrives, and neither the file nor what was saved of it meanwhile has anything of the
preview but the picture. window.py says what it needs.
"""

from __future__ import annotations

import argparse
import random
import shutil
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

#: Longest wait before a key, in seconds: Blender's start, renders and the end of a small preview all fall in.
LONGEST_WAIT = 2.5
#: What a user does meanwhile, and how often.
ACTIONS = {"undo": 6, "redo": 2, "move": 3, "delete": 1, "save": 2}


class Hands:
    """What the user does, by keys where there is a key without a dialogue."""

    def __init__(self, driver: window.Driver, file: Path) -> None:
        self.driver, self.file = driver, file
        self.undone = self.saved = 0
        bpy.app.handlers.undo_post.append(self._count)

    def _count(self, *_):
        self.undone += 1

    def undo(self):
        yield from self._press("Z", ctrl=True)

    def redo(self):
        yield from self._press("Z", ctrl=True, shift=True)

    def move(self):
        cube = next((obj for obj in bpy.data.objects if obj.type == "MESH"), None)
        if cube is not None:
            cube.location.z += 0.01
        self.remember("Move")
        yield 0.0

    def delete(self):
        obj = bpy.data.objects.get("Spare")
        if obj is not None:
            bpy.data.objects.remove(obj)
        self.remember("Delete")
        yield 0.0

    def save(self):
        yield from self._press("S", ctrl=True)
        self.saved += 1

    def remember(self, message):
        """An undo step."""
        with bpy.context.temp_override(window=self.driver.window):
            bpy.ops.ed.undo_push(message=message)

    def _press(self, key, **modifiers):
        place = self.driver.view.x + 200, self.driver.view.y + 200
        yield from self.driver.move(*place, 0.02)
        for value in ("PRESS", "RELEASE"):
            self.driver.window.event_simulate(type=key, value=value, x=place[0], y=place[1], **modifiers)
        yield 0.05


def contents() -> dict[str, list[str]]:
    """Names of what the file must keep, by kind."""
    kinds = ("scenes", "worlds", "materials", "cameras", "node_groups", "libraries")
    return {kind: sorted(data.name for data in getattr(bpy.data, kind)) for kind in kinds}


def story(driver: window.Driver, options: argparse.Namespace):
    """Relight again and again, each time with other keys at other moments."""
    import small_scene

    from dante_w_addon.blender import pictures
    from dante_w_addon.operators import relight

    chance = random.Random(options.seed)
    relight.STILL_SIZE, relight.TILE_SIZE = 160, 64
    tile = (64 + pictures.GAP, 48 + pictures.GAP)
    sizes = (160, 120), (4 * tile[0] - pictures.GAP, 2 * tile[1] - pictures.GAP)
    file, copy = options.shots / "undone.blend", options.shots / "saved.blend"
    yield 1.0
    yield from driver.open_tab()
    small_scene.build(options.shots / "photos")
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Spare", None))
    bpy.context.scene.dante_w.samples = 8
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    hands = Hands(driver, file)
    hands.remember("Scene")  # what a script does is no undo step by itself
    for _ in range(10):
        yield from hands.move()
    before = contents()
    rounds = 0
    while hands.undone < options.undos:
        every = rounds % 2 == 1
        with bpy.context.temp_override(window=driver.window, area=driver.view):
            bpy.ops.dantew.relight("INVOKE_DEFAULT", every=every)
        assert relight.active is not None, f"the preview did not start: {relight.last_message}"
        started = time.monotonic()
        keys = []
        yield chance.uniform(0.0, LONGEST_WAIT)
        while relight.active is not None:
            action = chance.choices(list(ACTIONS), list(ACTIONS.values()))[0]
            keys.append(f"{action} {time.monotonic() - started:.1f}")
            print(keys[-1], flush=True)
            yield from getattr(hands, action)()
            yield chance.uniform(0.0, LONGEST_WAIT)
        assert not relight.last_message, relight.last_message
        picture = bpy.data.images.get(relight.SHEET if every else relight.PREVIEW)
        assert picture is not None and tuple(picture.size) == sizes[every], "no picture"
        assert contents() == before, f"{contents()} is not {before}"
        rounds += 1
        print(f"round {rounds}, {'contact sheet' if every else 'preview'}: {', '.join(keys)}", flush=True)
        shutil.copy(file, copy)
        with bpy.data.libraries.load(str(copy)) as (saved, _):
            assert saved.scenes == before["scenes"] and saved.worlds == before["worlds"], saved.scenes
        for _ in range(5):
            yield from hands.move()
    assert hands.saved, "nothing was saved meanwhile; take another seed"
    print(f"{hands.undone} undos, {hands.saved} saves in {rounds} rounds", flush=True)


def parse(arguments: list[str]) -> argparse.Namespace:
    """The same options outside and inside."""
    parser = argparse.ArgumentParser(description="Undo, redo and save while relighting renders.")
    parser.add_argument("--shots", type=Path, required=True, help="folder for the saved file")
    parser.add_argument("--undos", type=int, default=20, help="at least so many")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--blender", default="blender", help="command that starts Blender")
    return parser.parse_args(arguments)


def run(blender: str, shots: Path, undos: int, seed: int) -> int:
    """Do it, from outside; returns Blender's exit code, which is no 0 where it crashed."""
    arguments = ["--shots", str(shots.resolve()), "--undos", str(undos), "--seed", str(seed)]
    return window.outside(blender, shots, "undo_in_window.py", arguments)


if __name__ == "__main__":
    if bpy is None:
        given = parse(sys.argv[1:])
        sys.exit(run(given.blender, given.shots, given.undos, given.seed))
    given = parse(sys.argv[sys.argv.index("--") + 1 :])
    window.inside(lambda driver: story(driver, given), given.shots)
