"""Points of an object's evaluated mesh, in the object's space: under a ray, near a place, and their UV."""

from __future__ import annotations

import bpy
from mathutils import Vector, geometry

from ..contract.errors import BadInput
from . import mesh


def cast_ray(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, origin: Vector, direction: Vector
) -> tuple[Vector, int] | None:
    """The first point of `obj` that a ray in world space meets, and its face; None for a miss."""
    evaluated_obj = obj.evaluated_get(depsgraph)
    if not evaluated_obj.data.polygons:
        return None
    to_object = evaluated_obj.matrix_world.inverted_safe()
    is_hit, point, _, face = evaluated_obj.ray_cast(to_object @ origin, to_object.to_3x3() @ direction)
    return (point, face) if is_hit else None


def nearest_point(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, location: Vector
) -> tuple[Vector, int]:
    """The point of `obj` that is nearest to `location`, and its face.

    Raises:
        BadInput: there are no faces.
    """
    evaluated_obj = obj.evaluated_get(depsgraph)
    if not evaluated_obj.data.polygons:
        raise BadInput(f"{obj.name} has no faces; choose a mesh with faces.")
    _, point, _, face = evaluated_obj.closest_point_on_mesh(location)
    return point, face


def uv_at(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, point: Vector, face: int
) -> tuple[float, float, str]:
    """U and V of a point on a face of the mesh as it is exported, and the name of their UV map.

    Raises:
        BadInput: there is no UV map.
    """
    evaluated_obj = obj.evaluated_get(depsgraph)
    data = evaluated_obj.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    try:
        layer = mesh.render_uv_map(data)
        if layer is None:
            raise BadInput(f"{obj.name} has no UV map; unwrap it first.")
        return (*_interpolated(data, layer, point, face), layer.name)
    finally:
        evaluated_obj.to_mesh_clear()


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

    nearest = min(triangles, key=lambda triangle: (closest(triangle) - point).length_squared)
    uvs = [layer.uv[index].vector.to_3d() for index in nearest.loops]
    u, v, _ = geometry.barycentric_transform(closest(nearest), *corners(nearest), *uvs)
    return u, v
