"""What the tests of relighting share: the picture of a scene, and everything that the file holds."""

import time

import bpy

from dante_w_addon.blender import hdris, studio
from dante_w_addon.bridge.relighting import Relighting
from dante_w_addon.operators import relight

TINY = studio.Look(samples=4, size=64)
FOREST, CITY = hdris.presets()["forest"], hdris.presets()["city"]
COLLECTIONS = [  # `all_ids` is all others together
    entry.identifier
    for entry in bpy.types.BlendData.bl_rna.properties
    if entry.type == "COLLECTION" and entry.identifier != "all_ids"
]


def relit(hdri, look=TINY):
    """The picture of the scene under one HDRI."""
    with Relighting(bpy.context, [hdri], look) as relighting:
        return relighting.wait()


def tick_until(done, seconds=120.0):
    """Be the timer, which a Blender without a window does not have."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "it does not end"
        relight.tick()
        time.sleep(0.02)


def datablocks():
    """Everything in the file, by kind and name."""
    return {kind: sorted(data.name_full for data in getattr(bpy.data, kind)) for kind in COLLECTIONS}


def state():
    """All that a preview might change, but for its picture."""
    scene = bpy.context.scene
    render = scene.render
    found = datablocks()
    found["images"] = [name for name in found["images"] if name not in (relight.PREVIEW, relight.SHEET)]
    return (
        *(render.engine, render.resolution_x, render.resolution_y, render.resolution_percentage),
        *(
            render.filepath,
            render.image_settings.file_format,
            scene.cycles.samples,
            scene.cycles.use_denoising,
        ),
        *(scene.world, scene.camera, scene.frame_current, bpy.context.window.scene.name),
        *(bpy.data.filepath, found),
    )
