"""The sun as a light of its own: found from the shadow it throws, left out where there is none."""

import dataclasses

import numpy as np
import pytest
from dante_w.rays.raycast import Frame3D, Raycaster
from dante_w.scene.mesh import Mesh
from dante_w.traced.albedo_texture import Surface, direct_irradiance
from dante_w.traced.light_transport import LightTransport, sun_visibility, trace_light_transport, with_suns
from dante_w.traced.observations import Observations
from dante_w.traced.shading_points import ShadingPoints
from dante_w.traced.solver.evidence import gather_evidence
from dante_w.traced.solver.settings import SolverSettings
from dante_w.traced.solver.solve_lights import solve_lights
from dante_w.traced.solver.variable_projection import project_albedo
from dante_w.traced.specular import specular_radiance
from dante_w.traced.state import Components, Lighting
from dante_w.traced.sun import USUAL_SUN, SunSettings, _bounded, find_and_add_suns, peaks

SIDE, PHOTOS = 40, 4
SUN = np.array([0.55, 0.2, 0.81]) / np.linalg.norm([0.55, 0.2, 0.81])
COMPONENTS = Components(exposures=False, bounce=False, specular=False)
SETTINGS = SolverSettings()
CUBE = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def ground(posts: bool) -> Mesh:
    """A square of ground in the unit cube, with three posts on it or without."""
    vertices = [np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)])]
    faces = [(0, 1, 2), (0, 2, 3)]
    for x, y, height in ((0.2, 0.3, 0.3), (0.45, 0.65, 0.25), (0.2, 0.75, 0.2)) if posts else ():
        first = sum(map(len, vertices))
        vertices.append(CUBE * (0.1, 0.1, height) + (x, y, 0.02))
        faces += [tuple(first + q[i] for i in three) for q in QUADS for three in ((0, 1, 2), (0, 2, 3))]
    return Mesh(np.concatenate(vertices), np.array(faces, np.int32), None)


class World:
    """Photos of the ground under an even sky and a sun of the given strength beside it."""

    def __init__(self, strength: float, posts: bool = True) -> None:
        mesh = ground(posts)
        self.caster = Raycaster(mesh, Frame3D(np.zeros(3), 1.0))
        centre = (np.arange(SIDE) + 0.5) / SIDE
        x, y = (each.ravel() for each in np.meshgrid(centre, centre))
        position = np.stack([x, y, 0.0 * x], axis=1).astype(np.float32)
        normal = np.tile(np.float32((0.0, 0.0, 1.0)), (SIDE**2, 1))
        self.points = ShadingPoints(np.arange(SIDE**2, dtype=np.int32), position, normal)
        uvs = np.zeros((len(mesh.faces), 3, 2))
        self.transport = trace_light_transport(self.points, self.caster, uvs, 256, lambda _: None)
        patches = np.where((np.floor(x * 3) + np.floor(y * 3)) % 2 == 0, 0.5, 0.3)
        self.albedo = patches[:, None] * np.array([1.0, 0.8, 0.6])
        sunny = sun_visibility(position, normal, self.caster, SUN)
        light = self.transport.direct.sum(axis=1) + strength * sunny * SUN[2]
        noise = np.random.default_rng(0).normal(1.0, 0.01, (PHOTOS, SIDE**2, 3))
        colour = (0.3 * self.albedo * light[:, None] * noise).reshape(-1, 3).astype(np.float32)
        rows = PHOTOS * SIDE**2
        observations = Observations(
            np.tile(np.arange(SIDE**2, dtype=np.int32), PHOTOS),
            np.repeat(np.arange(PHOTOS, dtype=np.int32), SIDE**2),
            colour,
            np.full(rows, 4, np.int32),
            np.zeros(rows, bool),
        )
        self.cameras = np.array([(0.5 + 0.3 * k, 0.5, 3.0) for k in range(PHOTOS)])
        self.evidence = gather_evidence(
            self.points, observations, self.cameras, SETTINGS.evidence, COMPONENTS
        )

    def solved(self) -> Lighting:
        one = np.zeros(PHOTOS, np.int64)
        return solve_lights(self.evidence, self.transport, one, SETTINGS, 0, lambda *_: None)

    def with_suns(
        self, lights: Lighting, settings: SunSettings = USUAL_SUN
    ) -> tuple[LightTransport, Lighting]:
        return find_and_add_suns(self.evidence, self.transport, lights, self.caster, 0, SETTINGS, settings)

    def error(self, lights: Lighting) -> float:
        """Standard deviation of the error of log albedo: scale and white balance are open."""
        off = np.log(lights.albedo / self.albedo)[lights.known]
        return float((off - off.mean(axis=0)).std())


@pytest.mark.parametrize("strength", [2.0, 6.0])
def test_a_sun_is_found_where_it_stands_and_its_shadows_leave_the_albedo(strength):
    world = World(strength)
    lights = world.solved()
    transport, lighting = world.with_suns(lights)
    assert transport.suns == 1 and lighting.setbacks == ()
    assert np.degrees(np.arccos(transport.directions[-1] @ SUN)) < 2.0
    assert world.error(lighting) < 0.6 * world.error(lights)


@pytest.mark.parametrize(("strength", "posts"), [(0.0, True), (4.0, False)])
def test_without_a_sun_or_without_shadows_there_is_none(strength, posts):
    world = World(strength, posts)
    lights = world.solved()
    transport, same = world.with_suns(lights)
    assert transport is world.transport and same is lights


def test_the_light_that_a_sun_replaces_keeps_a_twentieth():
    """All of the sun's light lies in one part of the sphere, whose shadows are blurred: all that can be is taken from it."""
    world = World(6.0)
    radiance = np.full((1, 256, 3), 0.01, np.float32)
    cosine = world.transport.directions @ SUN
    radiance[0, cosine.argmax()] = 6.0 / world.transport.share
    lights = dataclasses.replace(world.solved(), radiance=radiance)
    irradiance, matte = lights.irradiance(world.transport), np.zeros_like(world.evidence.weight)
    log_albedo, _ = project_albedo(lights, irradiance, matte, world.evidence, SETTINGS.projection)
    lights = dataclasses.replace(lights, albedo=np.exp(log_albedo))
    found = world.with_suns(lights, SunSettings(steps=0))[1].radiance[0, :256]
    near, far = np.sort(cosine)[-2], cosine.argmin()  # beside the brightest, and away from it
    np.testing.assert_allclose(found[cosine == near][0] / found[far], 0.05, rtol=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_a_peak_loses_no_more_than_all_and_a_sun_is_not_negative(seed):
    """The changes of peak and sun against all on a fine grid that are allowed."""
    random = np.random.default_rng(seed)
    slopes, wanted = random.normal(size=(3, 2)), random.uniform(-3.0, 3.0, 2)
    if seed % 5 == 0:
        slopes[:, 1] = slopes[:, 0]  # peak and sun are the same to these points: then there is no sun
    matrix = slopes.T @ slopes
    right = matrix @ wanted
    peak, sun = np.meshgrid(np.linspace(-1.0, 5.0, 601), np.linspace(0.0, 5.0, 501))

    def cost(peak, sun):
        quadratic = matrix[0, 0] * peak**2 + 2.0 * matrix[0, 1] * peak * sun + matrix[1, 1] * sun**2
        return quadratic - 2.0 * (right[0] * peak + right[1] * sun)

    found = _bounded(matrix, right)
    assert found[0] >= -1.0 and found[1] >= 0.0
    assert cost(*found) <= cost(peak, sun).min() + 1e-6


def test_a_sun_is_seen_but_where_the_mesh_is_in_its_way():
    caster = Raycaster(ground(posts=False), Frame3D(np.zeros(3), 1.0))
    position = np.array([(0.5, 0.5, -0.3), (0.5, 0.5, 0.3), (0.9, 0.5, -0.3), (0.5, 0.5, 0.3)])
    normal = np.array([(0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (0.9, 0.0, 0.4), (0.0, 0.0, -1.0)])
    slanted = np.array([0.8, 0.0, 0.6])
    np.testing.assert_array_equal(sun_visibility(position, normal, caster, slanted), [0.0, 1.0, 1.0, 0.0])
    at_edge = np.array([(0.6, 0.5, -0.3)])  # the ground ends where the sun's middle is seen
    assert 0.0 < sun_visibility(at_edge, np.array([(0.0, 0.0, 1.0)]), caster, slanted)[0] < 1.0


def test_suns_leave_the_sphere_as_it_was():
    world = World(1.0)
    transport = with_suns(world.transport, world.points, world.caster, SUN[None])
    assert transport.share == world.transport.share == 4.0 / 256 and transport.suns == 1
    np.testing.assert_allclose(
        transport.direct[:, -1],
        transport.share
        * SUN[2]
        * sun_visibility(world.points.position, world.points.normal, world.caster, SUN),
        rtol=1e-6,
    )
    radiance = np.random.default_rng(0).random((1, 256, 3)).astype(np.float32)
    dark = np.concatenate([radiance, np.zeros((1, 1, 3), np.float32)], axis=1)
    point, light = np.arange(50), np.zeros(50, np.int64)
    towards = world.points.towards(point, world.cameras[0])
    shown = [
        specular_radiance(point, light, towards, world.points.normal, each, emitted)
        for each, emitted in ((world.transport, radiance), (transport, dark))
    ]
    np.testing.assert_allclose(shown[0], shown[1], rtol=1e-6)


def test_pixels_see_the_sun_for_themselves():
    world = World(1.0)
    transport = with_suns(world.transport, world.points, world.caster, SUN[None])
    radiance = np.concatenate([np.ones((256, 3)), np.full((1, 3), 90.0)]).astype(np.float32)
    fine = (np.arange(400) + 0.5) / 400
    place = np.stack([fine, np.full(400, 0.34), 0.0 * fine], axis=1).astype(
        np.float32
    )  # through a post's shadow
    point, normal = world.points.at(place[:, :2]), np.tile(np.float32((0.0, 0.0, 1.0)), (400, 1))
    lit = direct_irradiance(Surface(point, place, normal), transport, radiance, world.caster)
    sky = direct_irradiance(Surface(point, place, normal), world.transport, radiance[:256], world.caster)
    sunny = sun_visibility(place, normal, world.caster, SUN)
    sun = transport.share * 90.0 * SUN[2] * sunny
    np.testing.assert_allclose(lit - sky, np.repeat(sun[:, None], 3, axis=1), atol=1e-5)
    by_cell = transport.visible[point, -1]
    assert {0.0, 1.0} <= set(sunny) and (np.abs(sunny - by_cell) > 0.5).any()  # finer than the cells


def test_how_much_brighter_than_the_mean_a_light_is_anywhere():
    lights = dataclasses.replace(World(0.0).solved(), radiance=np.ones((2, 4, 3), np.float32))
    lights.radiance[1, 2] = 5.0
    np.testing.assert_allclose(peaks(lights), [1.0, 2.5])
