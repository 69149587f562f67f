"""The result on the object: a material with the albedo, the original materials one click away.

All of it is kept in custom properties of the object. So it is saved with the .blend, follows undo, and works in headless
runs and where the add-on is off.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import bpy

from ..contract.report import COVERAGE, albedo_file, read_report, summary
from . import mesh

#: Custom properties of a textured object.
ALBEDO, ORIGINALS, REPORT_TEXT = "dante_w_albedo", "dante_w_originals", "dante_w_report"


def apply(obj: bpy.types.Object, result: Path, pack: bool) -> bpy.types.Material:
    """Put the albedo of a result folder on `obj` and show it; its own materials are kept.

    Args:
        result: the result folder.
        pack: whether the images are kept inside the .blend.

    Raises:
        OSError, ValueError: the folder is not a whole result.
    """
    report = read_report(result)
    texture = result / albedo_file(summary(report).file_format)
    albedo = load_image(texture, f"{obj.name} albedo", pack)
    coverage = load_image(result / COVERAGE, f"{obj.name} coverage", pack, "Non-Color")
    layer = mesh.render_uv_map(obj.data)
    material = albedo_material(f"{obj.name} albedo", albedo, coverage, layer.name if layer else "")
    if display_of(obj) != "ALBEDO":
        obj[ORIGINALS] = {str(i): slot.material for i, slot in enumerate(obj.material_slots) if slot.material}
    obj[ALBEDO] = material
    obj[REPORT_TEXT] = json.dumps(report, indent=1)
    show(obj, "ALBEDO")
    return material


def display_of(obj: bpy.types.Object) -> str | None:
    """What `obj` shows: 'ALBEDO' or 'ORIGINAL'; None for an object without a result."""
    material = obj.get(ALBEDO)
    if material is None:
        return None
    return "ALBEDO" if any(slot.material == material for slot in obj.material_slots) else "ORIGINAL"


def show(obj: bpy.types.Object, which: str) -> None:
    """Switch every slot of `obj` to the albedo ('ALBEDO') or back to what it had ('ORIGINAL')."""
    if not obj.material_slots:
        obj.data.materials.append(None)
    originals = obj.get(ORIGINALS, {})
    for index, slot in enumerate(obj.material_slots):
        slot.material = obj[ALBEDO] if which == "ALBEDO" else originals.get(str(index))


def report_of(obj: bpy.types.Object) -> dict[str, Any]:
    """The report of the object's result; empty where there is none."""
    try:
        return dict(json.loads(obj.get(REPORT_TEXT, "{}")))
    except (ValueError, TypeError):
        return {}


def load_image(path: Path, name: str, pack: bool, colour_space: str | None = None) -> bpy.types.Image:
    """Load an image. Its colour space is set, as Blender's guess depends on the user's settings: `colour_space`, or
    sRGB, or linear for EXR and HDR."""
    image = bpy.data.images.load(str(path), check_existing=False)
    image.name = name
    linear = path.suffix.lower() in (".exr", ".hdr")
    image.colorspace_settings.name = colour_space or ("Linear Rec.709" if linear else "sRGB")
    if pack:
        image.pack()
    elif bpy.data.filepath and bpy.context.preferences.filepaths.use_relative_paths:
        with contextlib.suppress(ValueError):  # another drive on Windows
            image.filepath = bpy.path.relpath(str(path))
    return image


def albedo_material(
    name: str, albedo: bpy.types.Image, coverage: bpy.types.Image | None, uv_map: str
) -> bpy.types.Material:
    """A Principled BSDF without specular reflection: the diffuse part was recovered, the rest is the artist's to add."""
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
    texture = tree.nodes.new("ShaderNodeTexImage")
    uv = tree.nodes.new("ShaderNodeUVMap")
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    texture.image, texture.label = albedo, "Albedo"
    uv.uv_map = uv_map
    for node, x in ((uv, -800), (texture, -580), (shader, -280), (output, 40)):
        node.location = (x, 0)
    tree.links.new(uv.outputs["UV"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    if coverage is not None:
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image, node.label, node.location = coverage, "Coverage (white: a photo saw it)", (-580, -320)
        tree.links.new(uv.outputs["UV"], node.inputs["Vector"])
    tree.nodes.active = texture  # what texture painting and the Solid view's Texture mode use
    return material
