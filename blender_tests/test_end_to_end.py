"""One recovery with the real backend, from Cycles photos to the object's material."""

import math
import time

import bpy
import numpy as np
import pytest
from small_scene import add_camera, add_cube, set_photo

from dante_w_addon.blender import material
from dante_w_addon.bridge import job

ALBEDO = np.array((0.6, 0.3, 0.1))  # linear


@pytest.fixture
def rendered(tmp_path):
    """Photos of a cube of one colour, rendered under a grey sky."""
    cube = add_cube()
    paint = cube.active_material
    if bpy.app.version < (5, 0, 0):
        paint.use_nodes = True
    shader = next(node for node in paint.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (*ALBEDO, 1.0)
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("Sky")
    if bpy.app.version < (5, 0, 0):
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 16
    scene.render.resolution_x, scene.render.resolution_y = 96, 72
    scene.render.film_transparent = True
    scene.render.image_settings.color_mode = "RGBA"
    scene.view_settings.view_transform = "Standard"
    for index in range(8):
        angle = math.pi / 4.0 * index + 0.3
        height = 3.5 if index % 2 else -3.5
        camera = add_camera(f"Camera {index}", (5.0 * math.cos(angle), 5.0 * math.sin(angle), height))
        scene.camera = camera
        scene.render.filepath = str(tmp_path / f"photo {index}.png")
        bpy.ops.render.render(write_still=True)
        set_photo(camera, bpy.data.images.load(scene.render.filepath))
    bpy.context.view_layer.objects.active = cube
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "rendered.blend"))
    return cube


def recover(texture_size):
    """Recover with the draft preset, as the panel would, and wait."""
    settings = bpy.context.scene.dante_w
    settings.preset, settings.texture_size, settings.device = "draft", str(texture_size), "cpu"
    assert bpy.ops.dantew.recover() == {"FINISHED"}
    end = time.monotonic() + 400.0
    while job.tick() is not None:
        assert time.monotonic() < end
        time.sleep(0.1)
    assert job.recovery.progress.state == "done", job.recovery.progress.message
    return job.recovery.progress.report


def seen_colours(obj):
    """Linear albedo of the texels that a photo saw, (N, 3)."""
    nodes = obj.active_material.node_tree.nodes
    albedo = nodes.active.image
    coverage = next(node.image for node in nodes if node.label.startswith("Coverage"))
    pixels = np.array(albedo.pixels).reshape(-1, 4)[:, :3]
    seen = np.array(coverage.pixels).reshape(-1, coverage.channels)[:, 0] > 0.9
    return ((pixels[seen] + 0.055) / 1.055) ** 2.4


def test_photos_become_an_albedo(addon, rendered, backend_python):
    report = recover(1024)
    assert report["held_out_psnr"] > 20.0 and report["coverage"] > 0.8
    assert material.display_of(rendered) == "ALBEDO"
    assert tuple(rendered.active_material.node_tree.nodes.active.image.size) == (1024, 1024)
    colours = seen_colours(rendered)
    assert len(colours) > 100_000
    middle = np.median(colours, axis=0)
    assert middle / middle.sum() == pytest.approx(ALBEDO / ALBEDO.sum(), abs=0.08), "the hue is the albedo's"


def test_a_known_colour_is_met(addon, rendered, backend_python):
    encoded = 1.055 * ALBEDO ** (1.0 / 2.4) - 0.055
    bpy.ops.dantew.pick_known_colour(location=(0, 0, 1), grey=False, colour=tuple(encoded))
    recover(1024)
    assert np.median(seen_colours(rendered), axis=0) == pytest.approx(ALBEDO, rel=0.1)


def test_new_uvs_come_with_the_albedo(addon, rendered, backend_python):
    while rendered.data.uv_layers:
        rendered.data.uv_layers.remove(rendered.data.uv_layers[0])
    bpy.context.scene.dante_w.unwrap = True
    recover(1024)
    textured = bpy.context.view_layer.objects.active
    assert material.display_of(textured) == "ALBEDO"
    assert textured.data.uv_layers["DANTE-W"].active_render
    middle = np.median(seen_colours(textured), axis=0)
    assert middle / middle.sum() == pytest.approx(ALBEDO / ALBEDO.sum(), abs=0.08)
