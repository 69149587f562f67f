"""The demo's own object: a painted Suzanne on a tiled plinth, so that the demo downloads nothing. Needs bpy.

The paint is a function of the surface point, evaluated for every texel; all colours are linear albedo
between 0.05 and 0.85.
"""

from __future__ import annotations

import math

import bmesh
import bpy
import numpy as np
import studio

TEXTURE_SIZE = 1024
SKIN, EYES, PLINTH = 0, 1, 2
SPREAD = 2  # texels painted beyond the islands, for bilinear lookups at seams
PLINTH_RADIUS, PLINTH_HEIGHT = 1.62, 0.42

CORAL = (0.72, 0.20, 0.11)
OCHRE = (0.76, 0.43, 0.10)
ROSE = (0.70, 0.24, 0.27)
CREAM = (0.82, 0.74, 0.58)
TEAL = (0.05, 0.36, 0.36)
NAVY = (0.06, 0.09, 0.24)
WHITE = (0.85, 0.83, 0.79)
LEAF = (0.22, 0.42, 0.09)
SKY = (0.18, 0.45, 0.72)

#: 5 x 7 dots each, a row a number, for the marks around the plinth.
LETTERS = {
    "D": (30, 17, 17, 17, 17, 17, 30),
    "A": (14, 17, 17, 31, 17, 17, 17),
    "N": (17, 25, 25, 21, 19, 19, 17),
    "T": (31, 4, 4, 4, 4, 4, 4),
    "E": (31, 16, 16, 30, 16, 16, 31),
    "-": (0, 0, 0, 31, 0, 0, 0),
    "W": (17, 17, 17, 21, 21, 27, 17),
    "*": (0, 4, 21, 14, 21, 4, 0),
    " ": (0, 0, 0, 0, 0, 0, 0),
}
MARKS = "DANTE-W * "


def build() -> tuple[bpy.types.Object, bpy.types.Image]:
    """The object, UV-mapped, and its true albedo texture (sRGB)."""
    suzanne, plinth = make_suzanne(), make_plinth()
    local = np.concatenate([paint_space(suzanne), paint_space(plinth)])
    parts = np.concatenate([suzanne_parts(suzanne), np.full(len(plinth.data.vertices), PLINTH)])
    suzanne.rotation_euler[0] = -0.3  # as it sits on its chin and the back of its head
    bpy.context.view_layer.update()
    heights = np.array([(suzanne.matrix_world @ vertex.co).z for vertex in suzanne.data.vertices])
    suzanne.location.z = -0.02 - heights.min()  # a little sunk in, so that it stands
    thing = studio.join([suzanne, plinth])
    thing.name = "Suzanne"
    unwrap(thing)
    surface, part = surface_map(thing, local, parts, TEXTURE_SIZE)
    colours = np.clip(paint(surface, part), 0.05, 0.85)
    colours[part < 0] = colours[part >= 0].mean(axis=0)
    return thing, as_image(colours.reshape(TEXTURE_SIZE, TEXTURE_SIZE, 3))


def make_suzanne() -> bpy.types.Object:
    bpy.ops.mesh.primitive_monkey_add(size=2.0)
    suzanne = bpy.context.object
    suzanne.modifiers.new("Smooth", "SUBSURF").levels = 2
    bpy.ops.object.modifier_apply(modifier="Smooth")
    bpy.ops.object.shade_smooth()
    return suzanne


def make_plinth() -> bpy.types.Object:
    bpy.ops.mesh.primitive_cylinder_add(
        vertices=96, radius=PLINTH_RADIUS, depth=PLINTH_HEIGHT, location=(0.0, 0.12, -0.5 * PLINTH_HEIGHT)
    )
    plinth = bpy.context.object
    bevel = plinth.modifiers.new("Edge", "BEVEL")
    bevel.width, bevel.segments = 0.03, 2
    bpy.ops.object.modifier_apply(modifier="Edge")
    mesh = bmesh.new()  # no camera sees the underside, and it would take a quarter of the texture
    mesh.from_mesh(plinth.data)
    under = [face for face in mesh.faces if face.normal.z < -0.9]
    bmesh.ops.delete(mesh, geom=under, context="FACES")
    mesh.to_mesh(plinth.data)
    mesh.free()
    return plinth


def paint_space(thing: bpy.types.Object) -> np.ndarray:
    """(V, 3) vertex positions in the object's own space, where its paint is defined."""
    points = np.empty(3 * len(thing.data.vertices), np.float32)
    thing.data.vertices.foreach_get("co", points)
    return points.reshape(-1, 3).astype(np.float64)


def suzanne_parts(suzanne: bpy.types.Object) -> np.ndarray:
    """SKIN or EYES per vertex: the eyes are pieces of their own, all but the largest piece."""
    count = len(suzanne.data.vertices)
    edges = np.empty(2 * len(suzanne.data.edges), np.int32)
    suzanne.data.edges.foreach_get("vertices", edges)
    ends = edges.reshape(-1, 2)
    label = np.arange(count)
    while True:  # the smallest index spreads along the edges until nothing changes
        spread = label.copy()
        np.minimum.at(spread, ends[:, 0], label[ends[:, 1]])
        np.minimum.at(spread, ends[:, 1], label[ends[:, 0]])
        spread = spread[spread]
        if np.array_equal(spread, label):
            break
        label = spread
    largest = np.bincount(label).argmax()
    return np.where(label == largest, SKIN, EYES)


def unwrap(thing: bpy.types.Object) -> None:
    for layer in list(thing.data.uv_layers)[1:]:
        thing.data.uv_layers.remove(layer)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.quads_convert_to_tris()
    bpy.ops.uv.smart_project(angle_limit=math.radians(66.0), island_margin=0.004)
    bpy.ops.object.mode_set(mode="OBJECT")


def surface_map(
    thing: bpy.types.Object, local: np.ndarray, parts: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Per texel, bottom row first: (T, 3) point in paint space, and part, -1 outside the islands."""
    mesh = thing.data
    mesh.calc_loop_triangles()
    corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("loops", corners)
    vertices = np.empty_like(corners)
    mesh.loop_triangles.foreach_get("vertices", vertices)
    uv = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers[0].data.foreach_get("uv", uv)
    texels = uv.reshape(-1, 2)[corners].reshape(-1, 3, 2).astype(np.float64) * size - 0.5
    vertices = vertices.reshape(-1, 3)
    point = np.zeros((size, size, 3))
    part = np.full((size, size), -1)
    for margin in (SPREAD, 0):  # what truly lies on a triangle overwrites what was spread
        for corner, vertex in zip(texels, vertices, strict=True):
            edges = np.column_stack([corner[1] - corner[0], corner[2] - corner[0]])
            area = np.linalg.det(edges)
            if abs(area) < 1e-9:
                continue
            low = np.maximum(np.floor(corner.min(axis=0) - margin).astype(int), 0)
            high = np.minimum(np.ceil(corner.max(axis=0) + margin).astype(int) + 1, size)
            x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
            offset = np.stack([x, y], axis=-1) - corner[0]
            second, third = np.moveaxis(offset @ np.linalg.inv(edges).T, -1, 0)
            weights = np.stack([1.0 - second - third, second, third], axis=-1)
            if margin:
                inside = np.ones(x.shape, bool)
                weights = np.clip(weights, 0.0, None)
                weights /= weights.sum(axis=-1, keepdims=True)
                inside = np.linalg.norm(weights @ corner - np.stack([x, y], axis=-1), axis=-1) <= margin
            else:
                inside = (weights >= 0.0).all(axis=-1)
            point[y[inside], x[inside]] = weights[inside] @ local[vertex]
            part[y[inside], x[inside]] = parts[vertex[0]]
    return point.reshape(-1, 3), part.reshape(-1)


def paint(point: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(T, 3) linear albedo."""
    colours = np.zeros_like(point)
    for which, painter in ((SKIN, paint_skin), (EYES, paint_eyes), (PLINTH, paint_plinth)):
        colours[part == which] = painter(point[part == which])
    return colours * (0.78 + 0.44 * noise(point * 55.0, 5))[:, None]


def paint_skin(point: np.ndarray) -> np.ndarray:
    """Warm clouds, a cream muzzle with freckles, teal contour lines with dots between, barred ears."""
    x, y, z = point.T
    cloud = noise(point * 1.7, 1) + 0.4 * noise(point * 6.0, 2)
    colour = mix(mix(CORAL, OCHRE, smooth(0.5, 0.9, cloud)), ROSE, smooth(0.75, 1.1, cloud + 0.3 * z))

    bands = 7.0 * np.hypot(x, 0.8 * (z - 0.15)) + 0.35 * np.sin(10.0 * np.arctan2(z - 0.15, x)) + 0.4 * cloud
    line = np.abs(bands - np.round(bands))
    colour = mix(colour, TEAL, 1.0 - smooth(0.07, 0.10, line))
    dots = np.sin(24.0 * np.arctan2(z - 0.15, x)) + 2.5 * (np.abs(line - 0.5) < 0.16) - 1.0
    colour = mix(colour, CREAM, smooth(2.0, 2.2, dots) * (np.round(bands - 0.5) % 2 == 0))

    muzzle = smooth(0.0, 0.06, 1.0 - np.hypot(x / 0.40, (z + 0.46) / 0.40)) * (y < -0.3)
    colour = mix(colour, CREAM, muzzle)
    freckles = smooth(0.74, 0.78, noise(point * 26.0, 3)) * muzzle
    colour = mix(colour, CORAL, freckles)

    ears = smooth(0.80, 0.83, np.abs(x))
    bars = np.sin(46.0 * (np.abs(x) + 0.12 * np.sin(9.0 * z)))
    colour = mix(colour, NAVY, ears * smooth(-0.15, 0.15, bars))
    colour = mix(colour, OCHRE, ears * smooth(-0.15, 0.15, -bars))

    crown = smooth(0.0, 0.03, z - 0.62 - 0.10 * np.abs(2.0 * ((x * 3.5) % 1.0) - 1.0))
    colour = mix(colour, NAVY, crown)
    checks = ((np.floor(x * 11.0) + np.floor(y * 11.0)) % 2) * smooth(0.80, 0.81, z)
    return mix(colour, LEAF, crown * checks)


def paint_eyes(point: np.ndarray) -> np.ndarray:
    """White, a sky-blue iris with spokes, a dark pupil."""
    middle = np.array([0.353, -0.80, 0.245])
    across, up = np.abs(point[:, 0]) - middle[0], point[:, 2] - middle[2]
    radius, angle = np.hypot(across, up), np.arctan2(up, across)
    colour = np.broadcast_to(WHITE, point.shape)
    spokes = mix(SKY, TEAL, smooth(-0.3, 0.3, np.sin(20.0 * angle)))
    colour = mix(colour, spokes, 1.0 - smooth(0.145, 0.15, radius))
    return mix(colour, NAVY, 1.0 - smooth(0.07, 0.075, radius))


def paint_plinth(point: np.ndarray) -> np.ndarray:
    """A chequered floor inside a ring of triangles; letters around the side."""
    x, y, z = point.T
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    cell = np.floor(np.column_stack([x, y]) * 3.6)
    inner = np.column_stack([x, y]) * 3.6 - cell - 0.5
    dark = (cell.sum(axis=1) % 2 == 0)[:, None]
    colour = np.where(dark, mix(NAVY, SKY, 0.25), mix(CREAM, WHITE, 0.5))
    star = np.hypot(*inner.T) * (1.0 + 0.35 * np.cos(8.0 * np.arctan2(inner[:, 1], inner[:, 0])))
    colour = mix(colour, np.where(dark, SKY, CORAL), 1.0 - smooth(0.20, 0.22, star))
    joint = np.abs(inner).max(axis=1)
    colour = mix(colour, mix(OCHRE, NAVY, 0.4), smooth(0.478, 0.486, joint))

    teeth = np.abs(2.0 * ((angle * 36.0 / (2.0 * math.pi)) % 1.0) - 1.0)
    ring = smooth(0.0, 0.006, radius - 1.33)
    colour = mix(colour, CREAM, ring)
    colour = mix(colour, CORAL, ring * smooth(0.0, 0.01, radius - 1.36 - 0.19 * teeth))

    side = smooth(0.0, 0.004, -(z - 0.5 * PLINTH_HEIGHT + 0.035))
    colour = mix(colour, TEAL, side)
    around = angle / (2.0 * math.pi) * 6.0 * len(MARKS) * 5  # the marks five times round, 6 dots a letter
    text = letters(around, (0.11 - z) / (0.22 / 7.0))
    colour = mix(colour, CREAM, side * text)
    border = smooth(0.0, 0.004, np.abs(z) - 0.145) * side
    stripes = np.sin(angle * 120.0 + 200.0 * np.abs(z))
    return mix(colour, np.where(stripes[:, None] > 0.0, OCHRE, NAVY), border)


def letters(column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """1 where MARKS, repeated along the columns of 6 dots a letter, has ink."""
    dots = np.zeros((7, 6 * len(MARKS)), np.float64)
    for index, letter in enumerate(MARKS):
        for line, bits in enumerate(LETTERS[letter]):
            for dot in range(5):
                dots[line, 6 * index + dot] = bits >> (4 - dot) & 1
    inside = (row >= 0.0) & (row < 7.0)
    return dots[np.clip(row, 0, 6).astype(int), np.floor(column).astype(int) % dots.shape[1]] * inside


def mix(a, b, share) -> np.ndarray:
    """From colour `a` to colour `b`; `share` may differ per point."""
    share = np.asarray(share, np.float64)[..., None]
    return np.asarray(a) * (1.0 - share) + np.asarray(b) * share


def smooth(low: float, high: float, value: np.ndarray) -> np.ndarray:
    """0 up to `low`, 1 from `high`, a smooth step between."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def noise(point: np.ndarray, seed: int) -> np.ndarray:
    """Value noise in [0, 1] with features of about one unit."""
    table = np.random.default_rng(seed).random((32, 32, 32))
    corner = np.floor(point).astype(int)
    t = point - corner
    t = t * t * (3.0 - 2.0 * t)
    total = np.zeros(len(point))
    for shift in np.ndindex(2, 2, 2):
        x, y, z = ((corner + shift) % 32).T
        total += table[x, y, z] * np.prod(np.where(shift, t, 1.0 - t), axis=1)
    return total


def as_image(linear: np.ndarray) -> bpy.types.Image:
    """An sRGB image datablock from (H, W, 3) linear colours, bottom row first."""
    height, width, _ = linear.shape
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    image = bpy.data.images.new("albedo", width, height)
    image.colorspace_settings.name = "sRGB"
    rgba = np.concatenate([encoded, np.ones((height, width, 1))], axis=2).astype(np.float32)
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    return image
