"""Points of an object's evaluated mesh, in the object's space: under a ray, near a place, and their UV."""

from __future__ import annotations

import bpy
from mathutils import Vector, geometry

from ..contract.errors import BadInput
from . import mesh


def under_ray(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, origin: Vector, direction: Vector
) -> tuple[Vector, int] | None:
    """The first point of `obj` that a ray in world space meets, and its face; None for a miss."""
    shown = obj.evaluated_get(depsgraph)
    if not shown.data.polygons:
        return None
    to_object = shown.matrix_world.inverted_safe()
    met, point, _, face = shown.ray_cast(to_object @ origin, to_object.to_3x3() @ direction)
    return (point, face) if met else None


def nearest(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, location: Vector) -> tuple[Vector, int]:
    """The point of `obj` that is nearest to `location`, and its face.

    Raises:
        BadInput: there are no faces.
    """
    shown = obj.evaluated_get(depsgraph)
    if not shown.data.polygons:
        raise BadInput(f"{obj.name} has no faces; choose a mesh with faces.")
    _, point, _, face = shown.closest_point_on_mesh(location)
    return point, face


def uv_at(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, point: Vector, face: int
) -> tuple[float, float, str]:
    """U and V of a point on a face of the mesh as it is exported, and the name of their UV map.

    Raises:
        BadInput: there is no UV map.
    """
    shown = obj.evaluated_get(depsgraph)
    data = shown.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    try:
        layer = mesh.render_uv_map(data)
        if layer is None:
            raise BadInput(f"{obj.name} has no UV map; unwrap it first.")
        return (*_interpolated(data, layer, point, face), layer.name)
    finally:
        shown.to_mesh_clear()


def _interpolated(
    data: bpy.types.Mesh, layer: bpy.types.MeshUVLoopLayer, point: Vector, face: int
) -> tuple[float, float]:
    """UV where `face` is closest to `point`; linear over each triangle, as the exported mesh has it."""
    data.calc_loop_triangles()
    polygon = data.polygons[face]
    first = polygon.loop_start - 2 * face  # n corners make n - 2 triangles, in the order of the polygons
    triangles = data.loop_triangles[first : first + polygon.loop_total - 2]

    def corners(triangle: bpy.types.MeshLoopTriangle) -> list[Vector]:
        return [data.vertices[index].co for index in triangle.vertices]

    def closest(triangle: bpy.types.MeshLoopTriangle) -> Vector:
        return geometry.closest_point_on_tri(point, *corners(triangle))

    hit = min(triangles, key=lambda triangle: (closest(triangle) - point).length_squared)
    uvs = [layer.uv[index].vector.to_3d() for index in hit.loops]
    u, v, _ = geometry.barycentric_transform(closest(hit), *corners(hit), *uvs)
    return u, v
