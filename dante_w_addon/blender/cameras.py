"""Blender cameras to pinhole intrinsics in pixels of their photo, and back.

The rule: **each camera is read as if the render resolution were its photo's size** (the scene's pixel
aspect stays). So portrait and landscape photos mix freely, and changing the render size, for a preview
say, never changes what is recovered. In the viewport the overlay shows the photo in the same place
whenever the render size has the photo's aspect; "Match Render to Photo" sets that.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ..contract import scene_folder
from ..contract.errors import BadInput

#: Custom property of an imported camera: calibration that a Blender camera cannot hold, such as distortion. Its keys are
#: `model`, `size`, `params` and `shown`, the intrinsics that the viewport had after the import.
CALIBRATION = "dante_w_calibration"


def intrinsics(camera: bpy.types.Camera, width: int, height: int, aspect: float = 1.0) -> scene_folder.Camera:
    """PINHOLE intrinsics of `camera` at a photo's resolution.

    Args:
        camera: a perspective camera.
        width, height: the photo's size in pixels.
        aspect: height of a pixel over its width, `pixel_aspect_y / pixel_aspect_x` of the render.
    """
    # Blender measures the sensor and the shift along the side that the fit selects; AUTO takes the
    # longer side of the picture, yet always the sensor's width.
    fit = camera.sensor_fit
    horizontal = fit == "HORIZONTAL" or (fit == "AUTO" and width >= height * aspect)
    sensor = camera.sensor_height if fit == "VERTICAL" else camera.sensor_width
    side = width if horizontal else height * aspect  # in widths of a pixel
    focal = camera.lens * side / sensor
    centre_x = width / 2.0 - camera.shift_x * side
    centre_y = height / 2.0 + camera.shift_y * side / aspect
    return scene_folder.Camera("PINHOLE", width, height, (focal, focal / aspect, centre_x, centre_y))


def pixel_aspect(scene: bpy.types.Scene) -> float:
    """Height of a pixel over its width."""
    return scene.render.pixel_aspect_y / scene.render.pixel_aspect_x


def pose(matrix: Sequence[Sequence[float]]) -> np.ndarray:
    """Float64 camera-to-world pose without the scale that a camera object may carry.

    Raises:
        BadInput: the camera is sheared or mirrored.
    """
    result = np.array(matrix, np.float64)
    axes = result[:3, :3] / np.linalg.norm(result[:3, :3], axis=0)
    if not np.allclose(axes.T @ axes, np.eye(3), atol=1e-4):
        raise BadInput("its transform is sheared; clear the scale of its parent")
    if np.linalg.det(axes) < 0.0:
        raise BadInput("it is mirrored by a negative scale; apply its scale")
    result[:3, :3] = axes
    return result


def set_intrinsics(
    camera: bpy.types.Camera, calibration: scene_folder.Camera, aspect: float = 1.0
) -> str | None:
    """Give `camera` the pinhole part of `calibration`.

    What a Blender camera cannot hold (distortion, two focal lengths that the scene's pixel aspect does not
    explain) is kept as a custom property and exported unchanged for as long as lens and shift are not edited.

    Returns:
        What the viewport cannot show, as a sentence for the user, or None.
    """
    width, height = calibration.width, calibration.height
    fx, fy, cx, cy = pinhole_part(calibration)
    camera.sensor_fit = "HORIZONTAL"
    camera.sensor_width = 36.0
    camera.lens = fx * 36.0 / width
    camera.shift_x = (width / 2.0 - cx) / width
    camera.shift_y = (cy - height / 2.0) * aspect / width
    viewport = intrinsics(camera, width, height, aspect)
    if calibration.model == "PINHOLE" and np.allclose(viewport.params, (fx, fy, cx, cy), rtol=0.0, atol=1e-3):
        return None
    camera[CALIBRATION] = {
        "model": calibration.model,
        "size": [width, height],
        "params": list(calibration.params),
        "shown": list(viewport.params),
    }
    if calibration.model == "PINHOLE":
        return "its two focal lengths differ; the viewport shows one, recovery uses both"
    return "its lens distortion is not shown in the viewport; recovery uses it"


def calibration(
    camera: bpy.types.Camera, width: int, height: int, aspect: float = 1.0
) -> scene_folder.Camera:
    """What to export: the imported calibration while the camera is as it was imported, else Blender's."""
    viewport = intrinsics(camera, width, height, aspect)
    entry = camera.get(CALIBRATION)
    if entry is None or list(entry["size"]) != [width, height]:
        return viewport
    if not np.allclose(list(entry["shown"]), viewport.params, rtol=1e-5, atol=1e-3):
        return viewport  # edited since the import: the user's lens wins
    return scene_folder.Camera(entry["model"], width, height, tuple(entry["params"]))


def pinhole_part(camera: scene_folder.Camera) -> tuple[float, float, float, float]:
    """(fx, fy, cx, cy) of any COLMAP camera, its distortion left out."""
    one_focal = camera.model.startswith("SIMPLE_") or camera.model in ("RADIAL", "RADIAL_FISHEYE")
    params = camera.params
    return (params[0], params[0], params[1], params[2]) if one_focal else tuple(params[:4])
