"""Points of the evaluated mesh: under a ray, near a place, and their UV in the mesh as it is exported."""

import math

import bpy
import numpy as np
import pytest
from dante_w_addon.contract.errors import BadInput
from mathutils import Matrix, Vector
from small_scene import add_cube

from dante_w_addon.blender import mesh, surface


def depsgraph():
    return bpy.context.evaluated_depsgraph_get()


def add_plane():
    """From -1 to 1, with UV = position / 2 + 0.5."""
    bpy.ops.mesh.primitive_plane_add(size=2.0)
    return bpy.context.view_layer.objects.active


def add_polygon(corners, uvs):
    """One face, as concave and as bent as it may be."""
    data = bpy.data.meshes.new("Polygon")
    data.from_pydata(corners, [], [range(len(corners))])
    data.uv_layers.new(name="UVMap").uv.foreach_set("vector", np.ravel(uvs))
    obj = bpy.data.objects.new("Polygon", data)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    return obj


def subdivided_cube():
    cube = add_cube()
    cube.modifiers.new("Finer", "SUBSURF").levels = 2
    return cube


def mirrored_cube():
    cube = add_cube()
    cube.matrix_world = Matrix.Translation((3.0, 1.0, 0.0)) @ Matrix.Diagonal((-2.0, 1.0, 0.5, 1.0))
    return cube


def cylinder():
    """Faces of 4 and of 7 corners, mixed."""
    bpy.ops.mesh.primitive_cylinder_add(vertices=7)
    return bpy.context.view_layer.objects.active


def bent_quad():
    corners = [(-1.0, -1.0, 0.0), (1.0, -1.0, 0.3), (1.0, 1.0, -0.4), (-1.0, 1.0, 0.5)]
    return add_polygon(corners, [(0.1, 0.1), (0.9, 0.2), (0.6, 0.9), (0.2, 0.6)])


def concave_polygon():
    angles = [2.0 * math.pi * i / 10 for i in range(10)]
    radii = [1.0, 0.4] * 5
    corners = [(r * math.cos(a), r * math.sin(a), 0.0) for r, a in zip(radii, angles, strict=True)]
    return add_polygon(corners, [(0.5 + 0.3 * x, 0.5 + 0.4 * y) for x, y, _ in corners])


def doubled_area(a, b, c):
    (x, y), (z, w) = (b - a).T, (c - a).T
    return x * w - y * z


def place_of(triangles, uv):
    """The points (N, 3) of an exported mesh that have this UV."""
    a, b, c = (triangles.uvs[triangles.uv_corners[:, i]] for i in range(3))
    areas = np.stack([doubled_area(uv, b, c), doubled_area(a, uv, c), doubled_area(a, b, uv)])
    weights = areas / doubled_area(a, b, c)
    inside = (weights > -1e-4).all(axis=0)
    corners = triangles.vertices[triangles.corners[inside]]
    return np.einsum("in,nij->nj", weights[:, inside], corners)


@pytest.mark.parametrize("make", [subdivided_cube, mirrored_cube, cylinder, bent_quad, concave_polygon])
def test_the_exported_mesh_has_the_uv_where_the_ray_met_it(make):
    obj = make()
    bpy.context.view_layer.update()
    exported = mesh.evaluated_triangles(obj, depsgraph())
    centre, random, hits = Vector(exported.vertices.mean(axis=0)), np.random.default_rng(0), 0
    for _ in range(40):
        direction = Vector(random.normal(size=3))
        target = centre + 0.5 * Vector(random.normal(size=3))
        hit = surface.cast_ray(obj, depsgraph(), target - 10.0 * direction, direction)
        if hit is None:
            continue
        hits += 1
        u, v, name = surface.uv_at(obj, depsgraph(), *hit)
        places = place_of(exported, np.array((u, v)))
        assert np.abs(places - np.array(obj.matrix_world @ hit[0])).max(axis=1).min() < 1e-3
        assert name == "UVMap"
    assert hits > 8


def test_the_nearest_point_is_found_and_its_uv():
    plane = add_plane()
    point, face = surface.nearest_point(plane, depsgraph(), Vector((0.4, -0.2, 0.7)))
    assert tuple(point) == pytest.approx((0.4, -0.2, 0.0))
    assert surface.uv_at(plane, depsgraph(), point, face)[:2] == pytest.approx((0.7, 0.4))


def test_the_uv_map_is_the_one_exported():
    plane = add_plane()
    second = plane.data.uv_layers.new(name="Second")
    second.uv.foreach_set("vector", np.full(8, 0.25, np.float32))
    plane.data.uv_layers.active = second
    at = (plane, depsgraph(), Vector((0.0, 0.0, 0.0)), 0)
    assert surface.uv_at(*at) == pytest.approx((0.5, 0.5, "UVMap"))
    second.active_render = True
    bpy.context.view_layer.update()
    assert surface.uv_at(plane, depsgraph(), Vector((0.0, 0.0, 0.0)), 0) == pytest.approx(
        (0.25, 0.25, "Second")
    )


def test_a_mesh_without_faces_or_uvs_is_refused():
    plane = add_plane()
    plane.data.uv_layers.remove(plane.data.uv_layers[0])
    plane.data.update()
    with pytest.raises(BadInput, match="no UV map"):
        surface.uv_at(plane, depsgraph(), Vector((0.0, 0.0, 0.0)), 0)
    plane.data.clear_geometry()
    bpy.context.view_layer.update()
    with pytest.raises(BadInput, match="no faces"):
        surface.nearest_point(plane, depsgraph(), Vector((0.0, 0.0, 0.0)))
    assert surface.cast_ray(plane, depsgraph(), Vector((0.0, 0.0, 1.0)), Vector((0.0, 0.0, -1.0))) is None
