"""Rays and projections of every COLMAP camera model, in float64. Photos are never resampled.

Camera space is OpenGL's: x right, y up, looking along -z. Pixels are continuous with the origin at the
top left corner of the photo, so the centre of the first pixel is (0.5, 0.5).
"""

from __future__ import annotations

import numpy as np

from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import Camera

#: Pixels by which a ray may miss the pixel that it was cast for.
TOLERANCE = 0.01


def directions(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Camera-space ray directions, scaled to z = -1.

    Args:
        camera: intrinsics; any COLMAP model.
        pixels: (N, 2) continuous pixel coordinates.

    Returns:
        (N, 3) float64. Not finite where the distortion has no inverse, or more than 90 degrees off axis.

    Raises:
        BadInput: the camera model or its number of parameters is unknown.
    """
    pixels = np.asarray(pixels, np.float64)
    if camera.model == "PINHOLE" and len(camera.params) == 4:
        fx, fy, cx, cy = camera.params
        with np.errstate(over="ignore"):  # a focal length of next to nothing
            flat = (pixels - (cx, cy)) / (fx, fy)
    else:
        model = _colmap(camera)
        flat = np.asarray(model.cam_from_img(pixels), np.float64).reshape(-1, 2)
        projected = model.img_from_cam(np.column_stack([flat, np.ones(len(flat))]))
        # beyond 90 degrees a fisheye's answer is some other pixel's ray
        flat[~(np.abs(projected - pixels) < TOLERANCE).all(axis=1)] = np.nan
    return np.column_stack([flat[:, 0], -flat[:, 1], -np.ones(len(flat))])


def project(camera: Camera, camera_to_world: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixel coordinates of world points; NaN for points behind the camera.

    Args:
        camera: intrinsics; any COLMAP model.
        camera_to_world: (4, 4) OpenGL pose.
        points: (N, 3) in world units.

    Returns:
        (N, 2) float64 continuous pixel coordinates.

    Raises:
        BadInput: the camera model or its number of parameters is unknown.
    """
    local = (np.asarray(points, np.float64) - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]
    local *= (1.0, -1.0, -1.0)  # COLMAP's camera space: y down, looking along +z
    local[local[:, 2] <= 0.0] = np.nan
    if camera.model == "PINHOLE" and len(camera.params) == 4:
        fx, fy, cx, cy = camera.params
        return local[:, :2] / local[:, 2:] * (fx, fy) + (cx, cy)
    return np.asarray(_colmap(camera).img_from_cam(local), np.float64).reshape(-1, 2)


def check_camera(camera: Camera) -> None:
    """Raise BadInput, without a file's name, unless rays can be cast for the camera."""
    if camera.width < 1 or camera.height < 1 or not np.isfinite(camera.params).all():
        raise BadInput(f"a {camera.model} camera has no size or is not finite; calibrate it again.")
    model = _colmap(camera)
    if min(model.params[index] for index in model.focal_length_idxs()) <= 0.0:
        raise BadInput(f"a {camera.model} camera's focal length is not positive; calibrate it again.")


def _colmap(camera: Camera):  # type: ignore[no-untyped-def]
    import pycolmap  # not above: only distorted cameras need it, and it must never meet Pillow

    if camera.model == "EQUIRECTANGULAR":
        raise BadInput("a camera is EQUIRECTANGULAR; cut the panoramas into PINHOLE photos.")
    exists = camera.model in pycolmap.CameraModelId.__members__ and camera.model != "INVALID"
    model = None
    if exists and 0 < camera.width < 2**31 and 0 < camera.height < 2**31:
        model = pycolmap.Camera(
            model=camera.model, width=camera.width, height=camera.height, params=list(camera.params)
        )
    if model is None or not model.verify_params():  # with too few, pycolmap would read beyond them
        raise BadInput(
            f"camera model {camera.model} with {len(camera.params)} parameters is not one of COLMAP's; "
            "export the cameras again."
        )
    return model
