"""Gradient-domain texturing with adobe-lagrange, the baseline that texturing tools offer.

`python benchmarks/methods/lagrange_texturing.py SCENE --out DIR [--texture-size N]` projects the photos onto the
mesh's own UVs and composites them so that colour steps between photos vanish; the photos' light stays in. Writes
DIR/albedo.png and prints the seconds of each part. Exit code 2: lagrange cannot do this scene.

Its settings are lagrange's own. It composites sRGB values as they stand in the photos, as its example does.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import lagrange
import numpy as np
from dante_w.contract.errors import BadInput, DanteError
from dante_w.contract.scene_folder import Frame
from dante_w.rays.raycast import Frame3D
from dante_w.scene.images import read_photo, write_png
from dante_w.scene.load import load_scene
from dante_w.scene.mesh import Mesh

LOW_CONFIDENCE = 0.75  #: lagrange's default: the share of a texel's best weight that a photo needs to count


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--mesh", type=Path, help="instead of the scene's own")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--texture-size", type=int, default=2048)
    options = parser.parse_args()
    try:
        scene, mesh = load_scene(options.scene, options.mesh)
        texture = texture_of(mesh, scene.frames, options.texture_size)
        options.out.mkdir(parents=True, exist_ok=True)
        write_png(options.out / "albedo.png", np.rint(np.clip(texture, 0.0, 1.0) * 255.0).astype(np.uint8))
    except DanteError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


def texture_of(mesh: Mesh, frames: list[Frame], size: int) -> np.ndarray:
    """The composited texture (size, size, 3), sRGB, top row (v = 1) first; prints what its parts took.

    Raises:
        BadInput: the photos are not of one size and undistorted, or lagrange refuses the mesh.
    """
    if len({(frame.camera.width, frame.camera.height) for frame in frames}) > 1:
        raise BadInput(f"{frames[0].image}: lagrange wants photos of one size; leave the others out.")
    start = time.monotonic()
    unit = Frame3D.bounding(mesh.vertices)  # lagrange's cameras are float32: keep positions small
    surface = surface_of(mesh, unit)
    cameras = [camera_of(frame, unit) for frame in frames]
    photos = [photo_of(frame) for frame in frames]
    start = lap("read photos", start)
    try:
        rgba, weights = lagrange.texproc.rasterize_textures_from_renders(
            surface, cameras, photos, width=size, height=size, low_confidence_ratio=0.0
        )
        colours = foreground_only(rgba, weights)
        start = lap("project", start)
        texture = lagrange.texproc.texture_compositing(surface, colours, weights, clamp_to_range=(0.0, 1.0))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise BadInput(f"lagrange refuses the mesh ({reason}); repair and unwrap it again.") from error
    lap("composite", start)
    return texture


def lap(name: str, start: float) -> float:
    """Print the seconds since `start`; returns the present time."""
    now = time.monotonic()
    print(f"{name}: {now - start:.1f} s", flush=True)
    return now


def surface_of(mesh: Mesh, unit: Frame3D) -> lagrange.SurfaceMesh:
    """The mesh in lagrange's form, in the unit cube.

    lagrange refuses triangles whose UVs run clockwise or have no area. Mirrored ones get their corners in the
    other order, which changes nothing else, since lagrange asks not which way a face points; and vertices of
    their own, since neighbours must still run through a shared edge in opposite directions. Triangles without
    area have no texels to fill and are left out.
    """
    if mesh.uvs is None:
        raise BadInput("the mesh has no UVs; unwrap it.")
    area = doubled_area(mesh.uvs)
    keep, mirrored = area != 0.0, area[:, None] < 0.0
    order = np.where(mirrored, (0, 2, 1), (0, 1, 2))
    faces = np.take_along_axis(mesh.faces, order, axis=1)[keep]
    uvs = np.take_along_axis(mesh.uvs, order[..., None], axis=1)[keep].reshape(-1, 2)
    _, charts = np.unique(uvs, axis=0, return_inverse=True)
    vertex, corners = welded(faces + mirrored[keep] * len(mesh.vertices))
    texel, uv_corners = welded(charts.reshape(-1, 3) + mirrored[keep] * len(uvs))
    surface = lagrange.SurfaceMesh()
    surface.add_vertices(unit.normalise(mesh.vertices)[faces.ravel()[vertex]])
    surface.add_triangles(corners)
    values = {"initial_values": uvs[texel], "initial_indices": uv_corners.ravel()}
    surface.create_attribute("uv", element="Indexed", usage="UV", **values)
    return surface


def welded(names: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number the corners of triangles: equal `names` (F, 3) are one point, as far as that makes a manifold.

    Triangles that run through an edge in the same direction as another one, for which lagrange refuses a mesh,
    get points of their own. Returns for each point the first corner that uses it, as an index into the flattened
    names, and the points of every triangle, uint32 (F, 3).
    """
    edges = np.stack([names, np.roll(names, -1, axis=1)], axis=2).reshape(-1, 2)
    _, edge, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    torn = (count[edge.ravel()] > 1).reshape(-1, 3).any(axis=1)
    own = names.max() + 1 + np.arange(names.size).reshape(-1, 3)
    _, first, point = np.unique(np.where(torn[:, None], own, names), return_index=True, return_inverse=True)
    return first, point.reshape(-1, 3).astype(np.uint32)


def doubled_area(uvs: np.ndarray) -> np.ndarray:
    """(F,) twice the signed area of triangles (F, 3, 2), positive if counterclockwise."""
    (ax, ay), (bx, by) = (uvs[:, 1] - uvs[:, 0]).T, (uvs[:, 2] - uvs[:, 0]).T
    return ax * by - ay * bx


def camera_of(frame: Frame, unit: Frame3D) -> lagrange.CameraTransforms:
    """View and projection matrices of a photo, from the unit cube.

    lagrange's camera space is OpenGL's, and so are its poses. It takes normalised device coordinates of -1 and 1
    for the centres of the outermost pixels, not for the photo's edges: hence width - 1, and the half pixel.
    """
    camera = frame.camera
    if camera.model != "PINHOLE":
        raise BadInput(f"{frame.image}: lagrange takes no {camera.model} camera; undistort the photos.")
    fx, fy, cx, cy = camera.params
    across, down = camera.width - 1, camera.height - 1
    near, far = 0.01, 100.0
    transforms = lagrange.CameraTransforms()
    pose = frame.camera_to_world.copy()
    pose[:3, 3] = unit.normalise(pose[:3, 3])
    transforms.view = np.asfortranarray(np.linalg.inv(pose), np.float32)
    transforms.projection = np.asfortranarray(
        [
            [2.0 * fx / across, 0.0, 1.0 - 2.0 * (cx - 0.5) / across, 0.0],
            [0.0, 2.0 * fy / down, 2.0 * (cy - 0.5) / down - 1.0, 0.0],
            [0.0, 0.0, (near + far) / (near - far), 2.0 * near * far / (near - far)],
            [0.0, 0.0, -1.0, 0.0],
        ],
        np.float32,
    )
    return transforms


def photo_of(frame: Frame) -> np.ndarray:
    """(H, W, 4) float32: sRGB, and 1 where the photo shows the object."""
    photo = read_photo(frame.image, frame.mask)
    return np.dstack([photo.srgb, photo.foreground.astype(np.float32)])


def foreground_only(rgba: list[np.ndarray], weights: list[np.ndarray]) -> list[np.ndarray]:
    """The colours (N, N, 3) of every photo's texels; `weights` (N, N, 1) are changed in place.

    They become 0 where background mixes in, and where another photo sees a texel much better: lagrange would do
    the latter itself, but before it knew of the background. Empties `rgba` as it goes, to save memory.
    """
    colours = []
    for weight in weights:
        texels = rgba.pop(0)
        weight[texels[..., 3] < 0.999] = 0.0
        colours.append(np.ascontiguousarray(texels[..., :3]))
    best = np.maximum.reduce(weights)
    for weight in weights:
        weight[weight < LOW_CONFIDENCE * best] = 0.0
    return colours


if __name__ == "__main__":
    sys.exit(main())
