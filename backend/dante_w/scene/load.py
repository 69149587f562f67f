"""Gather everything a command works on, and find bad input before any long work begins."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import Frame, Scene, read_scene
from dante_w.scene.colmap import is_colmap, read_colmap
from dante_w.scene.images import read_header
from dante_w.scene.mesh import Mesh, read_mesh

#: Log of the ratio of the aspect ratios of a photo and its prior: room for rounded sizes, none for cropped priors.
MOST_STRETCHED = 0.05


def load_scene(
    path: Path, mesh: Path | None = None, images: Path | None = None, priors: Path | None = None
) -> tuple[Scene, Mesh]:
    """Read a scene folder or a COLMAP model's parent, its photos' headers, and its mesh.

    Args:
        mesh: used instead of the scene's own.
        images: the photos of a COLMAP model.
        priors: a folder of albedo images named like the photos; a photo without one goes without.

    Raises:
        BadInput: something is missing, unreadable, or does not fit together.
    """
    scene = read_colmap(path, images) if is_colmap(path) and not _has_transforms(path) else read_scene(path)
    if priors is not None:
        scene = dataclasses.replace(scene, frames=_with_priors(scene.frames, priors))
    source = mesh or scene.mesh
    if source is None:
        raise BadInput(f"{path}: no mesh.obj, mesh.ply or mesh.glb here; name the mesh with --mesh.")
    if mesh is None and not source.resolve().is_relative_to(source.parent.resolve()):
        raise BadInput(f"{source}: is a link that leads out of the scene folder; name the mesh with --mesh.")
    scene = dataclasses.replace(scene, frames=[_with_header(frame) for frame in scene.frames])
    return scene, read_mesh(source)


def _has_transforms(path: Path) -> bool:
    return path.is_file() or (path / "transforms.json").is_file()


def _with_header(frame: Frame) -> Frame:
    """The frame with the exposure of its photo's header; refuses a photo or prior whose size does not fit."""
    photo, camera = read_header(frame.image), frame.camera
    if (photo.width, photo.height) != (camera.width, camera.height):
        raise BadInput(
            f"{frame.image}: the photo is {photo.width} x {photo.height} but its camera says {camera.width} x "
            f"{camera.height}; use the photos that were aligned, or correct the camera."
        )
    if frame.albedo is not None:
        prior = read_header(frame.albedo)
        if abs(math.log((prior.width / prior.height) / (photo.width / photo.height))) > MOST_STRETCHED:
            raise BadInput(
                f"{frame.albedo}: the prior is {prior.width} x {prior.height}, another shape than its photo "
                f"({photo.width} x {photo.height}); make it from the uncropped photo."
            )
    return dataclasses.replace(frame, log_exposure=photo.log_exposure)


def _with_priors(frames: list[Frame], folder: Path) -> list[Frame]:
    if not folder.is_dir():
        raise BadInput(f"{folder}: there is no such folder of priors; correct --priors.")
    by_stem = {path.stem: path.resolve() for path in sorted(folder.iterdir()) if path.is_file()}
    with_priors = [dataclasses.replace(frame, albedo=by_stem.get(frame.image.stem)) for frame in frames]
    if not any(frame.albedo for frame in with_priors):
        raise BadInput(
            f"{folder}: no prior is named like a photo ({frames[0].image.name}, ...); rename them."
        )
    return with_priors
