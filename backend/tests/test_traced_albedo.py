"""The texture from pixels under known light: its colour, and what people, clipping and edges do to it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from dante_w.core.color import srgb_from_linear_array
from dante_w.rays.ray_cache import RayCache, Surface
from dante_w.rays.raycast import Frame3D, Raycaster
from dante_w.scene.mesh import Mesh
from dante_w.traced.albedo_texture import AlbedoSettings, albedo_texture
from dante_w.traced.light_transport import trace_light_transport
from dante_w.traced.observations import ThinningSettings
from dante_w.traced.pixel_weights import USUAL
from dante_w.traced.shading_points import USUAL_SHADING, ShadingSettings, gather
from dante_w.traced.specular import specular_radiance
from dante_w.traced.state import Lighting, TracedScene

PHOTOS, SIZE, PIXELS = 9, 128, 150
IN_ORDER = np.arange(PHOTOS)
ALBEDO = np.array([0.6, 0.3, 0.15])
EXPOSURE = np.linspace(-0.4, 0.4, PHOTOS)
CAMERAS = np.column_stack([np.linspace(-0.4, 1.4, PHOTOS), np.full(PHOTOS, 0.3), np.full(PHOTOS, 2.0)])


@dataclasses.dataclass(frozen=True)
class World:
    """An open square of one colour under a grey sky, seen by photos that look at all of it; every other one under twice
    the light. `uv` (N, 2) of the samples."""

    cache: RayCache
    uv: np.ndarray

    def texture(
        self,
        shading: ShadingSettings = USUAL_SHADING,
        colour: np.ndarray | None = None,
        order: np.ndarray = IN_ORDER,
        cameras: np.ndarray = CAMERAS,
        bounce: float = 0.0,
    ) -> np.ndarray:
        """(SIZE, SIZE, 3) from the photos in some order, or from others of encoded colours (N, 3), or taken from elsewhere; with
        bounced light of so much times the sky's."""
        cache = self.cache if colour is None else dataclasses.replace(self.cache, colour=colour)
        cache, cameras = turned(cache, order), cameras[order]
        points, seen = gather(cache, cameras, shading)
        caster = Raycaster(MESH, FRAME)
        transfer = trace_light_transport(points, caster, UVS, 64, lambda _: None)
        lights = Lighting(
            RADIANCE,
            (np.arange(PHOTOS) % 2)[order],
            EXPOSURE[order],
            bounce * np.tile(RADIANCE[:, 0], (len(points), 1, 1)),
            np.ones((len(points), 3), np.float32),
            np.ones(len(points), bool),
            brightest_albedo=1.0,
        )
        cache = dataclasses.replace(cache, footprint=np.full(len(cache), 1.5 / SIZE, np.float32))
        scene = TracedScene(cameras, points, seen, transfer, None, None, lights.cluster)
        settings = AlbedoSettings(weights=shading.weights)
        return albedo_texture(cache, scene, lights, SIZE, lambda _: None, caster, settings)


def turned(cache: RayCache, order: np.ndarray) -> RayCache:
    """The photos in another order, or some of them."""
    count = cache.starts[1]
    rows = (order[:, None] * count + np.arange(count)).reshape(-1)
    assert cache.edge is not None
    columns = {name: getattr(cache, name)[rows] for name in ("face", "bary", "colour", "edge")}
    return dataclasses.replace(cache, starts=cache.starts[: len(order) + 1], **columns)


CORNERS = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)])
FACES = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
UVS = CORNERS[FACES][:, :, :2] * 0.25  # a chart of 64 x 64 shading points
MESH = Mesh(CORNERS, FACES, UVS)
FRAME = Frame3D.bounding(CORNERS)
RADIANCE = np.ones((2, 64, 3), np.float32) * np.array([1.0, 2.0], np.float32)[:, None, None]


@pytest.fixture(scope="module")
def world() -> World:
    """Photos of the square without anything wrong, the specular reflection that the method expects included."""
    random = np.random.default_rng(1)
    count = PIXELS**2
    face = random.integers(0, 2, (PHOTOS, count)).reshape(-1).astype(np.int32)
    bary = np.rint(random.dirichlet((1.0, 1.0, 1.0), PHOTOS * count)[:, 1:] * 65535.0).astype(np.uint16)
    surface = Surface(
        torch.from_numpy(UVS).float(), torch.from_numpy(FRAME.normalise(CORNERS)[FACES]).float()
    )
    starts = np.arange(PHOTOS + 1) * count
    empty = np.zeros((len(face), 3), np.float16)
    edge = np.full(len(face), 8, np.uint8)
    cache = RayCache(surface, starts, face, bary, empty, None, None, None, edge)
    points, seen = gather(cache, CAMERAS)
    transfer = trace_light_transport(points, Raycaster(MESH, FRAME), UVS, 64, lambda _: None)
    towards = CAMERAS[seen.photo] - points.position[seen.point]
    towards = (towards / np.linalg.norm(towards, axis=1, keepdims=True)).astype(np.float32)
    light = seen.photo % 2
    gloss = specular_radiance(seen.point, light, towards, points.normal, transfer, RADIANCE)
    shown = np.zeros((PHOTOS, len(points), 3))
    exposure = np.exp(EXPOSURE)[seen.photo, None]
    shown[seen.photo, seen.point] = exposure * ((1.0 + light)[:, None] * ALBEDO + gloss)
    weights = np.column_stack([65535.0 - bary.astype(float).sum(axis=1), bary]) / 65535.0
    uv = np.einsum("nc,ncd->nd", weights, UVS[face])
    photo = np.repeat(np.arange(PHOTOS), count)
    colour = srgb_from_linear_array(shown[photo, points.at(uv)])
    return World(dataclasses.replace(cache, colour=colour.astype(np.float16)), uv)


def weighed(**weights: float) -> ShadingSettings:
    return ShadingSettings(weights=dataclasses.replace(USUAL, **weights))


def inside(texture: np.ndarray) -> np.ndarray:
    """The texels of the chart, away from its outline."""
    side = SIZE // 4
    return texture[-side + 2 : -2, 2 : side - 2].reshape(-1, 3)


def photo_of(world: World) -> np.ndarray:
    return np.repeat(np.arange(PHOTOS), np.diff(world.cache.starts))


def test_the_albedo_comes_out_as_it_went_in(world):
    np.testing.assert_allclose(inside(world.texture()), np.broadcast_to(ALBEDO, (784, 3)), rtol=0.03)


def test_bounced_light_adds_to_the_irradiance(world):
    """The sky's irradiance is 1 (or 2), so bounced light of half as much leaves two thirds of the albedo."""
    lit = inside(world.texture(bounce=0.5))
    np.testing.assert_allclose(lit, np.broadcast_to(ALBEDO / 1.5, lit.shape), rtol=0.03)


def test_a_photo_of_a_sheets_other_side_does_not_count(world):
    """One of three photos looks from below, where the sky is not: too few for it to be an outlier."""
    below = np.where(IN_ORDER[:, None] == 4, CAMERAS * (1.0, 1.0, -1.0), CAMERAS)
    found = inside(world.texture(order=np.array([0, 4, 8]), cameras=below))
    np.testing.assert_allclose(found, np.broadcast_to(ALBEDO, found.shape), rtol=0.03)


def test_of_many_photos_some_observations_stand_for_all(world):
    whole, everything = inside(world.texture()), gather(world.cache, CAMERAS)[1]
    few = ThinningSettings(photos=4, anchors=64)  # of 256 cells a side
    points, seen = gather(world.cache, CAMERAS, ShadingSettings(thinning=few))
    cell = np.flatnonzero(points.point_of_cell >= 0)
    anchor = (cell % 256 % 4 == 0) & (cell // 256 % 4 == 0)
    views = np.bincount(seen.point)
    before = np.bincount(everything.point)
    np.testing.assert_array_equal(views, np.where(anchor, before, np.minimum(before, 4)))
    assert (np.bincount(seen.photo[~anchor[seen.point]]) > 0.3 * len(points)).all(), "no photo is left out"
    keys = everything.photo.astype(np.int64) * len(points) + everything.point
    rows = np.searchsorted(keys, seen.photo.astype(np.int64) * len(points) + seen.point)
    np.testing.assert_array_equal(seen.colour, everything.colour[rows])

    # thinned again and again on the way
    shading = ShadingSettings(thinning=dataclasses.replace(few, rows_held=len(points)))
    again = gather(world.cache, CAMERAS, shading)[1]
    np.testing.assert_array_equal(again.point, seen.point)
    np.testing.assert_array_equal(again.photo, seen.photo)
    np.testing.assert_allclose(inside(world.texture(shading)), whole, atol=0.02)


def test_people_in_some_photos_do_not_tint_the_texture(world):
    u, v = (world.uv * 4.0).T
    photo = photo_of(world)
    colour = np.array(world.cache.colour)
    # two people: one before each light, both over the middle
    somebody = ((photo == 3) | (photo == 6)) & (np.hypot(u - 0.5, v - 0.5) < 0.3)
    colour[somebody] = (0.1, 0.75, 0.9)
    clean, robust = inside(world.texture()), inside(world.texture(colour=colour))
    tinted = inside(world.texture(weighed(outlier=np.inf), colour))
    assert np.abs(robust - clean).max() < 0.02
    assert (np.abs(tinted - clean).max(axis=1) > 0.1).mean() > 0.2


def test_a_highlight_in_each_photo_leaves_no_trace(world):
    u, v = (world.uv * 4.0).T
    photo = photo_of(world)
    colour = np.array(world.cache.colour)
    shine = np.hypot(u - (photo + 1) / (PHOTOS + 1), v - 0.5) < 0.1
    colour[shine] = np.minimum(colour[shine] + 0.3, 0.99)
    clean, robust = inside(world.texture()), inside(world.texture(colour=colour))
    glossy = inside(world.texture(weighed(outlier=np.inf), colour))
    assert np.abs(robust - clean).max() < 0.02 < 0.05 < np.abs(glossy - clean).max()


def test_clipped_colours_do_not_darken_the_texture(world):
    colour = np.minimum(world.cache.colour, np.float16(1.0))
    only = weighed(noise=0.0, near_edge=0, outlier=np.inf)
    without = weighed(noise=0.0, near_edge=0, outlier=np.inf, clipped_from=np.inf)
    assert inside(world.texture(only, colour)).mean(axis=0) == pytest.approx(ALBEDO, rel=0.03)
    assert inside(world.texture(without, colour)).mean(axis=0)[0] < 0.95 * ALBEDO[0]


def test_colours_beside_edges_are_left_out_of_means_where_others_are(world):
    edge = np.full(len(world.cache), 8, np.uint8)
    spoilt = np.random.default_rng(2).random(len(edge)) < 0.3
    edge[spoilt] = 0
    colour = np.array(world.cache.colour)
    colour[spoilt] = 0.9
    cache = dataclasses.replace(world.cache, colour=colour, edge=edge)
    _, seen = gather(cache, CAMERAS)
    _, clean = gather(world.cache, CAMERAS)
    np.testing.assert_array_equal(seen.point, clean.point)
    some = seen.pixels > 0
    assert 0.5 < some.mean() < 1.0 and (seen.pixels[some] <= clean.pixels[some]).all()
    np.testing.assert_allclose(seen.colour[some], clean.colour[some], rtol=0.02)
    assert (seen.colour[~some] > 0.7).all()
    everything = gather(cache, CAMERAS, weighed(near_edge=0))[1]
    np.testing.assert_array_equal(everything.pixels, clean.pixels)


def test_the_order_of_photos_does_not_matter(world):
    order = np.random.default_rng(3).permutation(PHOTOS)
    np.testing.assert_allclose(world.texture(order=order), world.texture(), atol=1e-4)
