"""A stand-in for an albedo network: the true albedo of each view, spoilt in the ways networks spoil it.

No network's weights can be had here, so this makes pictures that are as far from the truth as a network's. What
is wrong with them comes in two kinds. *Shared* errors are a function of the surface point, the same from
everywhere, so no averaging over views removes them; *own* errors are drawn anew for each view, and averaging
does. With log standing for the log of linear colour, a prior is

    log prior = log blur(truth) + shared (bias + baked light + false detail)
                                + own (gain and tint + this photo's light + blotches + false detail)

and the blur is wider the larger both factors are. `Strength` holds the two factors, and `STRENGTHS` those that
bring the raw pictures and what lifting makes of them to the figures of the paper's table.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from dante_w.contract.scene_folder import read_scene
from measure.metrics import linear_from_srgb, srgb_from_linear
from measure.pictures import read, write
from measure.views import Surface, Viewer, linear_texture
from scipy.ndimage import distance_transform_edt, gaussian_filter


@dataclass(frozen=True)
class Strength:
    """How far a stand-in is from the truth: the factors of its shared and its own errors."""

    shared: float
    own: float


#: By the network whose figures they meet; `python3 dev.py bench stand_in_prior DIR --calibrate` finds them.
STRENGTHS = {
    "DiffusionRenderer": Strength(shared=0.8366, own=0.8228),
    "RGB-X": Strength(shared=0.8233, own=1.1256),
}

# Sizes of the errors at factor 1: standard deviations of log colour, powers of shading, or pixels of blur.
SHARED_BIAS, SHARED_LIGHT, SHARED_DETAIL, SHARED_BLUR = 0.14, 0.45, 0.10, 1.2
OWN_GAIN, OWN_TINT, OWN_LIGHT, OWN_BLOTCHES, OWN_DETAIL, OWN_BLUR = 0.15, 0.06, 0.30, 0.10, 0.08, 1.2
CHROMA = 0.35  # colour beside brightness in all noise; networks err less in hue than in brightness

# Wavelengths, longest and shortest: on the surface as parts of the object's size, in pictures as parts of theirs.
BROAD, FINE = (1.0, 0.3), (0.05, 0.015)
PICTURE_BROAD, PICTURE_FINE = (0.6, 0.15), (0.04, 0.012)

DARK = 0.02  # linear; added to photo and albedo, so that their ratio means something where both are black
LIGHT_RANGE = 2.0  # of log shading: deep shadows and highlights beyond it do not leak any further
LIGHT_BLUR = 2.0  # pixels; networks take soft shading for albedo, hardly what is as fine as texture
CELLS = 24  # of baked light along the object


class View(NamedTuple):
    """One camera and the errors of its prior at factor 1.

    file: the prior's path below the output folder. truth: linear albedo (H, W, 3), 0 where `inside` (H, W) is
    false. alpha: (H, W) of the file that the prior goes with. shared, own: (N, 3) log colour at the N pixels
    inside. blur: standard deviation in pixels at own factor 1.
    """

    file: str
    truth: np.ndarray
    inside: np.ndarray
    alpha: np.ndarray
    shared: np.ndarray
    own: np.ndarray
    blur: float


def make_priors(scene: Path, strength: Strength, out: Path) -> None:
    """Write `out`/train/NNN.png, named like the photos, and `out`/test/albedo_NNN.png, named like the truth.

    8-bit sRGB with the alpha of the photo or of the true albedo. The same scene and strength give the same bytes.
    """
    for view in observe(scene):
        colour = spoil(view, strength)
        # the writer takes colours times alpha and divides again
        write(out / view.file, np.dstack([colour * view.alpha[..., None], view.alpha]))


def spoil(view: View, strength: Strength) -> np.ndarray:
    """The prior of a view: sRGB (H, W, 3) in [0, 1]; outside the object, its nearest colour."""
    width = np.hypot(SHARED_BLUR * strength.shared, view.blur * strength.own)
    picture = blur(view.truth, view.inside, width)
    picture[view.inside] *= np.exp(strength.shared * view.shared + strength.own * view.own)
    nearest = distance_transform_edt(~view.inside, return_distances=False, return_indices=True)
    return srgb_from_linear(np.clip(picture, 0.0, 1.0))[tuple(nearest)]


@lru_cache(maxsize=4)
def observe(scene: Path) -> tuple[View, ...]:
    """Every training and test view of a scene. Kept for other strengths (300 MB for 48 views of 512 x 512), since
    the rays take longer than all the rest."""
    texture = linear_texture(next(scene.glob("albedo_gt.*")))
    light = BakedLight()
    seen = []
    for role, viewer, photos in roles(scene):
        for index, frame in enumerate(viewer.frames):
            surface = viewer.surface(index)
            picture, _ = viewer.view(texture, index)
            inside = np.zeros(picture.shape[:2], bool)
            inside.flat[surface.pixel] = True
            truth = np.where(inside[..., None], linear_from_srgb(picture), 0.0).astype(np.float32)
            shading = log_shading(photos[index], truth, inside)
            if role == "train":
                light.add(surface, shading)
            _, alpha = read(frame.image)
            seen.append((role, frame.image.name, surface, truth, inside, alpha, shading))
    views = []
    for role, name, surface, truth, inside, alpha, shading in seen:
        file = f"{role}/{name}"
        random = generator(scene.name, file)
        blur_width = OWN_BLUR * random.uniform(0.0, 1.0)
        own = own_error(surface.pixel, inside.shape, random)
        baked = light(surface)
        if shading is not None:  # what of this photo's light the others do not share; the rest is shared
            own = own + OWN_LIGHT * (shading - baked)
        shared = shared_error(scene.name, surface.position, baked)
        errors = shared.astype(np.float32), own.astype(np.float32)
        views.append(View(file, truth, inside, alpha, *errors, blur_width))
    return tuple(views)


def roles(scene: Path) -> Iterator[tuple[str, Viewer, list[Path | None]]]:
    """For training and test cameras: the folder of their priors, a viewer, and a photo for each (or None)."""
    for role in ("train", "test"):
        transforms = scene / f"transforms_{role}.json"
        viewer = Viewer(scene / "mesh.obj", read_scene(transforms).frames, keep=False)
        photos: list[Path | None] = [frame.image for frame in viewer.frames]
        if role == "test":
            entries = json.loads(transforms.read_text(encoding="utf-8"))["frames"]
            relit = [next(iter(entry.get("relit", {}).values()), None) for entry in entries]
            photos = [scene / name if name else None for name in relit]
        yield role, viewer, photos


def generator(*names: str) -> np.random.Generator:
    """Random numbers that depend on these names alone."""
    digest = hashlib.sha256("/".join(names).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "little"))


# --- errors that the surface carries ------------------------------------------------------------


class BakedLight:
    """The light that most photos agree on, which passes for paint: the mean of their log shading, blurred.

    It is kept in a coarse grid over the object for each of the six directions a surface can face, so it is
    darker in crevices and brighter on top, and two sides of a board do not mix.
    """

    def __init__(self) -> None:
        self._sum = np.zeros((6, CELLS**3, 4))  # three channels and their weight

    def add(self, surface: Surface, shading: np.ndarray) -> None:
        """Take in one photo's log shading (N, 3) at `surface`."""
        cell = np.ravel_multi_index(self._index(surface).T, (CELLS,) * 3)
        values = np.column_stack([shading, np.ones(len(cell))])
        for side, weight in enumerate(facing(surface.normal).T):
            for channel in range(4):
                self._sum[side, :, channel] += np.bincount(cell, weight * values[:, channel], CELLS**3)

    def __call__(self, surface: Surface) -> np.ndarray:
        """(N, 3) mean log shading at `surface`."""
        grid = gaussian_filter(self._sum.reshape(6, CELLS, CELLS, CELLS, 4), (0, 1, 1, 1, 0))
        cell = tuple(self._index(surface).T)
        found = sum(
            weight[:, None] * grid[side][cell] for side, weight in enumerate(facing(surface.normal).T)
        )
        return found[:, :3] / np.maximum(found[:, 3:], 1e-6)

    @staticmethod
    def _index(surface: Surface) -> np.ndarray:
        return np.clip((surface.position * CELLS).astype(int), 0, CELLS - 1)


def facing(normal: np.ndarray) -> np.ndarray:
    """(N, 6) how far a unit normal (N, 3) faces each half axis; the squares of its parts, so they sum to 1."""
    return np.concatenate([np.maximum(normal, 0.0), np.maximum(-normal, 0.0)], axis=1) ** 2


def shared_error(name: str, position: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(N, 3) error of log colour at factor 1 that all views of scene `name` share.

    A function of the surface: position (N, 3) in the unit cube, and the light (N, 3) baked there.
    """
    random = generator(name)
    bias = SHARED_BIAS * noise(position, BROAD, random)
    return bias + SHARED_LIGHT * light + SHARED_DETAIL * noise(position, FINE, random)


# --- errors of one view -------------------------------------------------------------------------


def own_error(pixel: np.ndarray, shape: tuple[int, int], random: np.random.Generator) -> np.ndarray:
    """(N, 3) error of log colour at raster index `pixel` (N,) of a picture of `shape`, at factor 1, without light."""
    place = np.column_stack(np.unravel_index(pixel, shape)) / max(shape)
    gain = OWN_GAIN * random.standard_normal() + OWN_TINT * random.standard_normal(3)
    blotches = OWN_BLOTCHES * noise(place, PICTURE_BROAD, random)
    return gain + blotches + OWN_DETAIL * noise(place, PICTURE_FINE, random)


def log_shading(photo: Path | None, truth: np.ndarray, inside: np.ndarray) -> np.ndarray | None:
    """(N, 3) log of photo / albedo at the pixels inside, soft, its mean (the exposure) taken out."""
    if photo is None:
        return None
    light = linear_from_srgb(read(photo)[0])
    ratio = np.log((light + DARK) / (truth + DARK))
    ratio = blur(ratio, inside, LIGHT_BLUR)[inside]
    return np.clip(ratio - ratio.mean(), -LIGHT_RANGE, LIGHT_RANGE)


# --- tools --------------------------------------------------------------------------------------


def noise(points: np.ndarray, wavelengths: tuple[float, float], random: np.random.Generator) -> np.ndarray:
    """Smooth noise (N, 3) at points (N, D): mean 0, deviation about 1, mostly grey, between two wavelengths.

    A sum of plane waves of random direction and phase, so it is a function of place, whichever points ask.
    """
    count = 48
    longest, shortest = wavelengths
    direction = random.standard_normal((points.shape[1], count))
    length = np.exp(random.uniform(np.log(shortest), np.log(longest), count))
    frequency = 2.0 * np.pi * direction / (np.linalg.norm(direction, axis=0) * length)
    phase = random.uniform(0.0, 2.0 * np.pi, count)
    weight = random.standard_normal((count, 3)) * np.sqrt(2.0 / count)
    grey = weight.mean(axis=1, keepdims=True)
    weight = np.sqrt(3.0) * grey + CHROMA * (weight - grey)
    return np.cos((points @ frequency + phase).astype(np.float32)) @ weight.astype(np.float32)


def blur(picture: np.ndarray, inside: np.ndarray, width: float) -> np.ndarray:
    """`picture` (H, W, 3) times a Gaussian of `width` pixels over the pixels inside (H, W); nothing else counts."""
    kept = np.where(inside[..., None], picture, 0.0).astype(np.float32)
    if width == 0.0:
        return kept
    weight = gaussian_filter(inside.astype(np.float32), width)[..., None]
    return np.where(
        inside[..., None], gaussian_filter(kept, (width, width, 0)) / np.maximum(weight, 1e-6), 0.0
    )
