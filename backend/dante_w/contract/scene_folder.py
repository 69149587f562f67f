"""The scene folder: posed photos and a mesh on disk, as nerfstudio and instant-ngp write them.

A scene folder holds `transforms.json`, the photos, a mesh with UVs and, per photo, an optional
foreground mask and an optional albedo prior. This module is the only one that knows the format.

Conventions. Poses are OpenGL camera-to-world: x right, y up, looking along -z, in the mesh's own
units, kept in float64. Pixels are continuous with the origin at the top left corner, so the centre of
the first pixel is (0.5, 0.5).

    {"mesh_path": "mesh.obj",
     "w": 640, "h": 480, "fl_x": 700.0, "fl_y": 700.0, "cx": 320.0, "cy": 240.0,
     "frames": [{"file_path": "images/a.png", "mask_path": "masks/a.png",
                 "albedo_path": "priors/a.png", "transform_matrix": [[...], ...]}]}

Intrinsics may stand at the top level or in a frame, where they win.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .errors import BadInput

#: transforms.json key of each intrinsic, in COLMAP's parameter order, per COLMAP camera model.
INTRINSIC_KEYS: dict[str, tuple[str, ...]] = {
    "PINHOLE": ("fl_x", "fl_y", "cx", "cy"),
    "OPENCV": ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "OPENCV_FISHEYE": ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4"),
}
MESH_SUFFIXES = (".obj", ".ply", ".glb")
LARGEST_SIDE = 2**20  #: pixels; more is a mistake


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one photo. `model` and `params` are COLMAP's (any COLMAP camera model);
    PINHOLE's params are (fx, fy, cx, cy) in pixels."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class Frame:
    """One photo: absolute paths, intrinsics, and the float64 4x4 OpenGL camera-to-world pose.

    `log_exposure` is the log of exposure time x sensitivity / f-number^2, in seconds and ISO, as the photo's own file
    says; None where it does not, and before the backend has read the file's header.
    """

    image: Path
    camera: Camera
    camera_to_world: np.ndarray
    mask: Path | None = None
    albedo: Path | None = None
    log_exposure: float | None = None


@dataclass(frozen=True)
class Scene:
    """Posed photos of one mesh. `source` is the file that was read, for messages."""

    source: Path
    mesh: Path | None
    frames: list[Frame] = field(default_factory=list)


def read_scene(path: Path) -> Scene:
    """Read a scene folder, or a transforms file named directly.

    Raises:
        BadInput: the file is missing or malformed, a pose is not a finite rigid transform, an
            intrinsic is missing, or a path leaves the scene folder.
    """
    source = _transforms_file(Path(path))
    try:
        # utf-8-sig: Windows tools write a byte order mark
        content = json.loads(source.read_text(encoding="utf-8-sig"))
        entries = content["frames"]
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise TypeError
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadInput(
            f"{source}: not a transforms.json with a list of frames; export the scene again."
        ) from error
    if not entries:
        raise BadInput(f"{source}: holds no frames; add at least one posed photo.")
    root = source.parent
    frames = [_frame(source, root, index, {**content, **entry}) for index, entry in enumerate(entries)]
    return Scene(source, _mesh_file(root, content.get("mesh_path")), frames)


def write_scene(folder: Path, scene: Scene) -> Path:
    """Write `transforms.json` for files that lie inside `folder`; returns its path.

    Raises:
        ValueError: a photo, mask, prior or mesh lies outside `folder`, or a number is not finite.
    """
    root = Path(folder).resolve()

    def inside(path: Path) -> str:
        return Path(path).resolve().relative_to(root).as_posix()

    content: dict[str, Any] = {}
    if scene.mesh is not None:
        content["mesh_path"] = inside(scene.mesh)
    content["frames"] = []
    for frame in scene.frames:
        entry: dict[str, Any] = {"file_path": inside(frame.image), **_camera_entry(frame.camera)}
        if frame.mask is not None:
            entry["mask_path"] = inside(frame.mask)
        if frame.albedo is not None:
            entry["albedo_path"] = inside(frame.albedo)
        entry["transform_matrix"] = np.asarray(frame.camera_to_world, np.float64).tolist()
        content["frames"].append(entry)
    target = root / "transforms.json"
    partial = target.with_suffix(".json.partial")
    partial.write_text(json.dumps(content, indent=1, allow_nan=False), encoding="utf-8")
    os.replace(partial, target)
    return target


def _transforms_file(path: Path) -> Path:
    with contextlib.suppress(OSError):  # a name too long for the system
        if path.is_file():
            return path.resolve()
        for name in ("transforms.json", "transforms_train.json"):
            if (path / name).is_file():
                return (path / name).resolve()
    raise BadInput(f"{path}: no transforms.json here; name a scene folder or the parent of a COLMAP model.")


def _frame(source: Path, root: Path, index: int, entry: Mapping[str, Any]) -> Frame:
    where = f"{source}: frame {index}"
    name = entry.get("file_path")
    if not isinstance(name, str) or not name:
        raise BadInput(f"{where} has no file_path; name its photo.")
    image = _inside(source, root, name)
    if not image.suffix and not os.path.exists(image):
        image = image.with_suffix(".png")  # the NeRF synthetic scenes leave the ending out
    mask, albedo = (
        _inside(source, root, entry[key]) if entry.get(key) else None for key in ("mask_path", "albedo_path")
    )
    return Frame(image, _camera(where, entry), _pose(where, entry.get("transform_matrix")), mask, albedo)


def _inside(source: Path, root: Path, name: Any) -> Path:
    try:
        path = (root / name).resolve()
    except (TypeError, OSError, ValueError, RuntimeError) as error:
        raise BadInput(f"{source}: {name!r} is not a usable path; correct it.") from error
    if path == root or not path.is_relative_to(root):
        raise BadInput(f"{source}: {name!r} lies outside the scene folder; move it inside.")
    return path


def _mesh_file(root: Path, name: Any) -> Path | None:
    if name:
        return _inside(root / "transforms.json", root, name)
    found: Iterable[Path] = (root / f"mesh{suffix}" for suffix in MESH_SUFFIXES)
    return next((path for path in found if path.is_file()), None)


def _pose(where: str, rows: Any) -> np.ndarray:
    try:
        pose = np.asarray(rows, np.float64)
    except (TypeError, ValueError, OverflowError):
        pose = np.empty(0)
    if pose.shape == (3, 4):
        pose = np.vstack([pose, [0.0, 0.0, 0.0, 1.0]])
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not np.allclose(pose[3], (0, 0, 0, 1)):
        raise BadInput(
            f"{where} has a pose that is not a finite 4x4 transform_matrix; align that photo again."
        )
    rotation = pose[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        scale = np.cbrt(np.linalg.det(rotation))
        unit = rotation / scale if 0.0 < scale < np.inf else np.zeros((3, 3))  # a mirror has a negative one
        rigid = np.allclose(unit.T @ unit, np.eye(3), atol=1e-3)
    if not rigid:
        raise BadInput(f"{where} has a pose that is not a rotation and a position; align that photo again.")
    pose[:3, :3] = unit  # Blender and RealityCapture may leave a uniform scale in the pose
    return pose


def _camera(where: str, entry: Mapping[str, Any]) -> Camera:
    def number(key: str) -> float:
        if key not in entry:
            raise BadInput(f"{where} has no {key}; write the camera's {key}.")
        return _finite(where, key, entry[key])

    width, height = int(number("w")), int(number("h"))
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE):
        raise BadInput(f"{where} has no usable image size; write the photo's w and h in pixels.")
    model = str(entry.get("camera_model", "OPENCV")).upper()
    if "params" in entry:
        if not isinstance(entry["params"], list):
            raise BadInput(f"{where} has params that are not a list; write COLMAP's camera parameters.")
        listed = {f"params[{i}]": value for i, value in enumerate(entry["params"])}
        params = tuple(_finite(where, key, value) for key, value in listed.items())
        if not params or params[0] <= 0.0 or len(params) != len(INTRINSIC_KEYS.get(model, params)):
            raise BadInput(f"{where} has params that are not those of {model}; write COLMAP's parameters.")
        return Camera(model, width, height, params)
    if model not in (*INTRINSIC_KEYS, "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        raise BadInput(f"{where} has camera_model {model}, which needs its COLMAP params as a list.")

    def half_tangent(key: str) -> float:
        angle = number(key)
        if not 1e-6 < angle < math.pi:
            raise BadInput(f"{where} has a {key} that is no field of view; write it in radians.")
        return math.tan(angle / 2.0)

    if "fl_x" in entry:
        focal_x = number("fl_x")
    elif "camera_angle_x" in entry:
        focal_x = width / (2.0 * half_tangent("camera_angle_x"))
    else:
        raise BadInput(f"{where} has neither fl_x nor camera_angle_x; write its focal length in pixels.")
    if "fl_y" in entry:
        focal_y = number("fl_y")
    elif "fl_x" not in entry and "camera_angle_y" in entry:
        focal_y = height / (2.0 * half_tangent("camera_angle_y"))
    else:
        focal_y = focal_x
    if focal_x <= 0.0 or focal_y <= 0.0:
        raise BadInput(f"{where} has a focal length that is not positive; calibrate that camera again.")
    centre_x = number("cx") if "cx" in entry else width / 2.0
    centre_y = number("cy") if "cy" in entry else height / 2.0
    distortion = {
        key: number(key) if key in entry else 0.0 for key in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
    }
    if not any(distortion.values()) and model != "OPENCV_FISHEYE":
        model = "PINHOLE"
    elif model != "OPENCV_FISHEYE":
        higher = any(distortion[key] for key in ("k3", "k4", "k5", "k6"))
        model = "FULL_OPENCV" if higher else "OPENCV"
    values = {"fl_x": focal_x, "fl_y": focal_y, "cx": centre_x, "cy": centre_y, **distortion}
    return Camera(model, width, height, tuple(values[key] for key in INTRINSIC_KEYS[model]))


def _finite(where: str, key: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise BadInput(f"{where} has a {key} that is not a finite number; calibrate that camera again.")
    return number


def _camera_entry(camera: Camera) -> dict[str, Any]:
    entry: dict[str, Any] = {"camera_model": camera.model, "w": camera.width, "h": camera.height}
    keys = INTRINSIC_KEYS.get(camera.model)
    if keys is None:
        return {**entry, "params": list(camera.params)}
    return {**entry, **dict(zip(keys, camera.params, strict=True))}
