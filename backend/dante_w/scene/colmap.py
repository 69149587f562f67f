"""Posed photos from a COLMAP model, text or binary, with any of its camera models.

Only `cameras` and `images` are read, which hold all that is needed: pycolmap's own reader also wants the
points, which are most of a model's bytes, and hangs on a binary model that was cut short.
"""

from __future__ import annotations

import ntpath
import posixpath
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import MESH_SUFFIXES, Camera, Frame, Scene
from dante_w.scene.cameras import check_camera

_FOLDERS = (".", "sparse/0", "sparse", "colmap/sparse/0")


def is_colmap(parent: Path) -> bool:
    """Whether a COLMAP model lies in `parent` or where COLMAP and nerfstudio put it below."""
    return _model_folder(Path(parent)) is not None


def read_colmap(parent: Path, images: Path | None = None) -> Scene:
    """Read the registered photos of a COLMAP model, sorted by name.

    Args:
        parent: the model's folder, or one that holds `sparse/0`, `sparse` or `colmap/sparse/0`.
        images: the photos' folder; `parent`/images unless given.

    Returns:
        A scene in COLMAP's world axes and units, poses OpenGL camera-to-world float64; the mesh is
        `parent`/mesh.obj, .ply or .glb if there is one. Photos' files are not looked at.

    Raises:
        BadInput: there is no model, it is damaged, no photo is registered, the photos' folder is missing,
            or a name leads out of it.
    """
    parent = Path(parent).resolve()
    folder = _model_folder(parent)
    if folder is None:
        raise BadInput(f"{parent}: holds no COLMAP model; name the folder that holds sparse/0.")
    photos = (parent / "images" if images is None else Path(images)).resolve()
    if images is None and not photos.is_relative_to(parent):
        raise BadInput(
            f"{parent / 'images'}: leads out of the scene folder; name the photos' folder with --images."
        )
    if not photos.is_dir():
        raise BadInput(f"{photos}: the photos' folder is missing; name it with --images.")
    cameras, registered = _load(folder)
    if not registered:
        raise BadInput(f"{folder}: no photo is registered; align the photos in COLMAP again.")
    frames = []
    for image in sorted(registered, key=lambda image: image.name):
        if image.camera not in cameras:
            raise BadInput(f"{folder}: the camera of {image.name} is not there; export the model again.")
        camera = cameras[image.camera]
        frames.append(Frame(_photo(folder, photos, image.name), camera, _pose(folder, image)))
    meshes = (parent / f"mesh{suffix}" for suffix in MESH_SUFFIXES)
    return Scene(folder, next((mesh for mesh in meshes if mesh.is_file()), None), frames)


def _model_folder(parent: Path) -> Path | None:
    for name in _FOLDERS:
        for suffix in (".bin", ".txt"):
            if all((parent / name / (part + suffix)).is_file() for part in ("cameras", "images")):
                return (parent / name).resolve()
    return None


@dataclass(frozen=True)
class _Image:
    """World to camera: unit quaternion (w, x, y, z) and translation, COLMAP's axes."""

    name: str
    camera: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]


def _load(folder: Path) -> tuple[dict[int, Camera], list[_Image]]:
    binary = (folder / "cameras.bin").is_file() and (folder / "images.bin").is_file()
    try:
        if binary:
            cameras = dict(_binary_cameras((folder / "cameras.bin").read_bytes()))
            images = list(_binary_images((folder / "images.bin").read_bytes()))
        else:
            cameras = dict(_text_cameras((folder / "cameras.txt").read_text(encoding="utf-8")))
            images = list(_text_images((folder / "images.txt").read_text(encoding="utf-8")))
    except (ValueError, IndexError, OverflowError, struct.error, OSError) as error:
        raise BadInput(f"{folder}: the COLMAP model is damaged; export it again.") from error
    for camera in cameras.values():
        try:
            check_camera(camera)
        except BadInput as error:
            raise BadInput(f"{folder}: {error}") from error
    return cameras, images


def _text_cameras(text: str) -> Iterator[tuple[int, Camera]]:
    for line in text.splitlines():
        words = line.split()
        if words and not words[0].startswith("#"):
            params = tuple(float(word) for word in words[4:])
            yield int(words[0]), Camera(words[1], int(words[2]), int(words[3]), params)


def _text_images(text: str) -> Iterator[_Image]:
    lines = iter(text.split("\n"))
    for line in lines:
        words = line.split(None, 9)
        if words and not words[0].startswith("#"):
            numbers = tuple(float(word) for word in words[1:8])
            yield _Image(words[9].rstrip(), int(words[8]), numbers[:4], numbers[4:])
            next(lines, None)  # the points it sees, which may be none: an empty line


def _binary_cameras(data: bytes) -> Iterator[tuple[int, Camera]]:
    import pycolmap

    (count,) = struct.unpack_from("<Q", data)
    position = 8
    for _ in range(count):
        number, model, width, height = struct.unpack_from("<IiQQ", data, position)
        kind = pycolmap.CameraModelId(model)
        size = len(pycolmap.Camera.create_from_model_id(0, kind, 1.0, 1, 1).params)
        yield number, Camera(kind.name, width, height, struct.unpack_from(f"<{size}d", data, position + 24))
        position += 24 + 8 * size


def _binary_images(data: bytes) -> Iterator[_Image]:
    (count,) = struct.unpack_from("<Q", data)
    position = 8
    for _ in range(count):
        numbers = struct.unpack_from("<I7dI", data, position)
        end = data.index(b"\0", position + 64)
        (points,) = struct.unpack_from("<Q", data, end + 1)
        yield _Image(data[position + 64 : end].decode(), numbers[8], numbers[1:5], numbers[5:8])
        position = end + 9 + 24 * points


def _photo(folder: Path, photos: Path, name: str) -> Path:
    for flavour in (posixpath, ntpath):  # a name must not escape on any system
        normal = flavour.normpath(name)
        if (
            flavour.isabs(normal)
            or ntpath.splitdrive(normal)[0]
            or normal.split(flavour.sep)[0] == ".."
            or not name
            or not name.isprintable()
        ):
            raise BadInput(f"{folder}: the photo name {name!r} leads out of {photos}; rename it in COLMAP.")
    photo = photos / name
    try:
        inside = photo.resolve().is_relative_to(photos)
    except (OSError, RuntimeError):  # a loop of links
        inside = False
    if not inside:
        raise BadInput(f"{photo}: is a link that leads out of {photos}; copy the photo there.")
    return photo


def _pose(folder: Path, image: _Image) -> np.ndarray:
    """OpenGL camera-to-world (4, 4) from COLMAP's world-to-camera, whose camera has y down and z forward."""
    quaternion = np.array(image.quaternion)
    with np.errstate(over="ignore", invalid="ignore"):
        length = float(np.linalg.norm(quaternion))
    if not np.isfinite(length) or length == 0.0 or not np.isfinite(image.translation).all():
        raise BadInput(
            f"{folder}: the pose of {image.name} is not a rotation and a position; align it again."
        )
    w, x, y, z = quaternion / length
    rotation = np.array(  # world from camera: the transpose of the quaternion's matrix
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
            [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
            [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    pose = np.eye(4)
    pose[:3, :3] = rotation * (1.0, -1.0, -1.0)
    pose[:3, 3] = -rotation @ np.array(image.translation)
    return pose
