"""Settings in saved .blend files: names, and the numbers that stand for a menu's entries."""

import bpy
from dante_w_addon.contract.vocabulary import COMPONENTS

from dante_w_addon.blender import known_colours, properties

#: A scene's settings as version 0.1.0 stored them in a .blend, and what they mean.
STORED = {
    "preset": (3, "paper"),
    "texture_size": (2, "2048"),
    "device": (2, "cuda"),
    "file_format": (2, "exr"),
    "irradiance": (1, "field"),
    "model_groups": (1, "ON"),
    "model_exposures": (0, "AUTO"),
    "model_bounce": (1, "ON"),
    "model_gloss": (2, "OFF"),
    "model_sun": (2, "OFF"),
    "storage": (1, "FILE"),
    "hdri": (2, "forest"),
    "unwrap": (1, True),
    "output_folder": ("/o", "/o"),
    "prior_folder": ("/p", "/p"),
    "rotation": (1.0, 1.0),
    "strength": (2.0, 2.0),
    "samples": (5, 5),
    "hdri_file": ("/x", "/x"),
}
#: Menus of version 0.1.0: entries may be added at the end alone.
MENUS = {
    "preset": "draft standard high paper",
    "texture_size": "AUTO 1024 2048 4096 8192 16384",
    "device": "auto cpu cuda mps",
    "file_format": "png png16 exr",
    "irradiance": "traced field",
    "model_sun": "AUTO ON OFF",
    "storage": "PACK FILE",
}
SPOT = {"u": 0.25, "v": 0.5, "uv_map": "UVMap", "grey": 0, "colour": (0.25, 0.5, 0.75)}


def stored(data):
    """Where Blender keeps what an add-on's properties hold, also while that is off."""
    if hasattr(data, "bl_system_properties_get"):
        return data.bl_system_properties_get(do_create=True)
    return data


def test_a_scene_of_version_0_1_0_keeps_its_settings():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    stored(scene)["dante_w"] = {name: value for name, (value, _) in STORED.items()}
    obj = bpy.data.objects.new("Mesh", bpy.data.meshes.new("Mesh"))
    stored(obj)["dante_w_known_colours"] = [SPOT]
    properties.register()
    known_colours.register()
    try:
        settings = properties.settings_of(scene)
        assert {name: getattr(settings, name) for name in STORED} == {
            name: meaning for name, (_, meaning) in STORED.items()
        }
        assert known_colours.as_words(obj) == (("0.250000", "0.500000", "#4080BF"),)
    finally:
        known_colours.unregister()
        properties.unregister()


def test_menus_keep_their_entries(addon, scene):
    for name, words in MENUS.items():
        entries = properties.settings_of(scene).bl_rna.properties[name].enum_items
        assert [entry.identifier for entry in entries][: len(words.split())] == words.split()
        assert [entry.value for entry in entries] == list(range(len(entries)))


def test_every_component_has_its_property(addon, scene):
    names = set(properties.settings_of(scene).bl_rna.properties.keys())
    assert {f"model_{component.key}" for component in COMPONENTS} == {
        name for name in names if name.startswith("model_")
    }
    assert set(STORED) <= names
