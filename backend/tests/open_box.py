"""The inside of an open box of known albedo, photographed under a sky that its walls hide and whose light they reflect.

Rendered by brute force, without the product's light transport: a ray inside a box leaves it through the plane that it
reaches first, so no ray tracer is needed. Light bounces until nothing is left of it. Colours are linear; a surface of
albedo 1 under a sky of 1 shows 1.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from dante_w.contract.scene_folder import Camera, Frame, Scene, write_scene
from dante_w.scene.images import write_png

WIDE, HIGH = 1.0, 0.8  #: The box is [0, 1] x [0, 1] x [0, 0.8], open above.
FLOOR, WEST, EAST, SOUTH, NORTH, SKY = range(6)
#: Of each plane: the axis it stands across, where, the axes of its two coordinates, and their lengths.
AXIS = np.array([2, 0, 0, 1, 1, 2])
PLACE = np.array([0.0, 0.0, WIDE, 0.0, WIDE, HIGH])
ACROSS = np.array([(0, 1), (1, 2), (1, 2), (0, 2), (0, 2), (0, 1)])
SIZE = np.array([(WIDE, WIDE), *[(WIDE, HIGH)] * 4, (WIDE, WIDE)])
#: Each side's square in the texture, of 3 x 2 of them, and the margin around it.
SQUARE, MARGIN = np.array([(0, 0), (1, 0), (2, 0), (0, 1), (1, 1)]), 0.03

#: The two colours of each side. Two walls are saturated and bleed onto the grey ones. The brightest albedo is 0.5, as the
#: product assumes where nothing says otherwise: how much light bounces depends on that.
COLOURS = np.array(
    [
        ((0.50, 0.50, 0.50), (0.30, 0.30, 0.30)),
        ((0.50, 0.06, 0.05), (0.30, 0.04, 0.03)),
        ((0.05, 0.10, 0.50), (0.03, 0.06, 0.30)),
        ((0.50, 0.50, 0.50), (0.30, 0.30, 0.30)),
        ((0.50, 0.50, 0.50), (0.30, 0.30, 0.30)),
    ]
)
CELLS, RAYS, BOUNCES = 16, 600, 8
CAMERA = Camera("PINHOLE", 120, 90, (80.0, 80.0, 60.0, 45.0))


def albedo_at(side: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(N, 3) linear albedo at places (N, 2) from 0 to 1 of sides (N,): checks of two colours, four along either edge."""
    check = np.floor(place * 4.0).clip(0, 3).astype(int).sum(axis=1) % 2
    return COLOURS[side, check]


def sky(direction: np.ndarray, number: int) -> np.ndarray:
    """(N, 3) radiance of one of two skies from unit vectors (N, 3): one lighter in the west, one in the south-east."""
    towards = np.array([(-0.6, 0.3, 0.74), (0.5, -0.6, 0.62)])[number]
    bright = 0.35 + 1.6 * np.maximum(direction @ towards, 0.0) ** 4
    return bright[:, None] * np.array([(1.05, 1.0, 0.95), (0.95, 1.0, 1.05)])[number]


def leaving(origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The plane (N,) at which rays (N, 3) from inside leave the box, and where on it, (N, 2) from 0 to 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (PLACE - origin[:, AXIS]) / direction[:, AXIS]
    outwards = direction[:, AXIS] * np.where(PLACE > 0.0, 1.0, -1.0) > 0.0
    side = np.where(outwards, distance, np.inf).argmin(axis=1)
    row = np.arange(len(side))
    point = origin + distance[row, side][:, None] * direction
    place = np.take_along_axis(point, ACROSS[side], axis=1) / SIZE[side]
    return side, place.clip(0.0, 1.0)


def centres() -> tuple[np.ndarray, np.ndarray]:
    """Sides (5 * CELLS**2,) and places (5 * CELLS**2, 2) of the cells' middles."""
    middle = (np.arange(CELLS) + 0.5) / CELLS
    u, v = np.meshgrid(middle, middle)
    return np.repeat(np.arange(5), CELLS**2), np.tile(np.stack([u.ravel(), v.ravel()], axis=1), (5, 1))


def cell_of(side: np.ndarray, place: np.ndarray) -> np.ndarray:
    column, row = np.minimum((place * CELLS).astype(int), CELLS - 1).T
    return (side * CELLS + row) * CELLS + column


def irradiance(random: np.random.Generator) -> np.ndarray:
    """(2, 5, CELLS, CELLS, 3) of the sides' cells under each sky, bounced light included: means over cosine-weighted rays."""
    side, place = centres()
    count = len(side)
    turn = 2.0 * np.pi * (np.arange(RAYS) * (np.sqrt(5.0) - 1.0) / 2.0 + random.random((count, 1)))
    radius = np.sqrt((np.arange(RAYS) + 0.5) / RAYS)
    tangent = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=-1)
    direction, origin = np.empty((count, RAYS, 3)), np.empty((count, 3))
    for each in range(5):
        mine = side == each
        direction[mine, :, AXIS[each]] = np.sqrt(1.0 - radius**2) * (1.0 if PLACE[each] == 0.0 else -1.0)
        origin[mine, AXIS[each]] = PLACE[each]
        for axis, length, own in zip(ACROSS[each], SIZE[each], range(2), strict=True):
            direction[mine, :, axis] = tangent[mine, :, own]
            origin[mine, axis] = place[mine, own] * length
    direction = direction.reshape(-1, 3)
    met, where = leaving(np.repeat(origin, RAYS, axis=0), direction)
    walls = np.flatnonzero(met != SKY)
    source, albedo = cell_of(met[walls], where[walls]), albedo_at(met[walls], where[walls])
    found = []
    for number in range(2):
        radiance = np.where((met == SKY)[:, None], sky(direction, number), 0.0)
        total = direct = radiance.reshape(count, RAYS, 3).mean(axis=1)
        for _ in range(BOUNCES):
            arriving = albedo * total[source]
            bounced = [np.bincount(walls // RAYS, channel, count) / RAYS for channel in arriving.T]
            total = direct + np.stack(bounced, axis=1)
        found.append(total.reshape(5, CELLS, CELLS, 3))
    return np.stack(found)


def between(grid: np.ndarray, side: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(N, 3) of a grid (5, CELLS, CELLS, 3) at places (N, 2) of sides (N,), bilinear."""
    at = (place * CELLS - 0.5).clip(0.0, CELLS - 1.0)
    low = np.minimum(at.astype(int), CELLS - 2)
    (u, v), (column, row) = (at - low).T[..., None], low.T
    upper = (1.0 - u) * grid[side, row, column] + u * grid[side, row, column + 1]
    lower = (1.0 - u) * grid[side, row + 1, column] + u * grid[side, row + 1, column + 1]
    return (1.0 - v) * upper + v * lower


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) the pose of a camera at `eye` that looks at `target`."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross((0.1, 1.0, 0.2), back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return pose


def photograph(pose: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(H, W, 3) sRGB uint8 of the box under `light`, as `irradiance` has it; black where a ray misses the opening."""
    fx, fy, cx, cy = CAMERA.params
    column, row = (np.indices((CAMERA.width, CAMERA.height)) + 0.5).transpose(0, 2, 1)
    rays = np.stack([(column - cx) / fx, (cy - row) / fy, -np.ones_like(row)], axis=-1).reshape(-1, 3)
    rays = rays @ pose[:3, :3].T
    enters = pose[:3, 3] + rays * ((HIGH - pose[2, 3]) / rays[:, 2:])
    inside = (rays[:, 2] < 0.0) & ((enters[:, :2] > 0.0) & (enters[:, :2] < WIDE)).all(axis=1)
    side, place = leaving(enters[inside], rays[inside])
    linear = np.zeros((len(rays), 3))
    linear[inside] = albedo_at(side, place) * between(light, side, place)
    assert linear.max() < 0.98, "nothing is clipped"
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clip(1e-9) ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * encoded).astype(np.uint8).reshape(CAMERA.height, CAMERA.width, 3)


def uv_of(side: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(N, 2) texture coordinates of places (N, 2) of sides (N,)."""
    return (SQUARE[side] + MARGIN + (1.0 - 2.0 * MARGIN) * place) / (3.0, 2.0)


def texels(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row-major numbers of the texels of a texture of `size` x `size` that lie on the box, and their sides and places."""
    middle = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(middle, middle[::-1])
    at = np.stack([u.ravel(), v.ravel()], axis=1) * (3.0, 2.0)
    square = np.floor(at)
    side = (square @ (1, 3)).astype(int)
    place = (at - square - MARGIN) / (1.0 - 2.0 * MARGIN)
    used = np.flatnonzero((side < 5) & ((place > 0.0) & (place < 1.0)).all(axis=1))
    return used, side[used], place[used]


def mesh() -> str:
    """The box as OBJ; faces look inwards."""
    lines = []
    for side in range(5):
        for place in ((0, 0), (1, 0), (1, 1), (0, 1)):
            corner = np.zeros(3)
            corner[AXIS[side]] = PLACE[side]
            corner[ACROSS[side]] = place * SIZE[side]
            u, v = uv_of(np.array([side]), np.array([place], float))[0]
            lines += ["v {} {} {}".format(*corner), f"vt {u} {v}"]
        first, second, third, fourth = (f"{n}/{n}" for n in range(4 * side + 1, 4 * side + 5))
        if side in (EAST, SOUTH):
            second, fourth = fourth, second
        lines += [f"f {first} {second} {third}", f"f {first} {third} {fourth}"]
    return "\n".join(lines) + "\n"


def make_open_box(folder: Path, photos: int = 6, exposure: float = 0.9) -> Path:
    """A scene folder of the box; every other photo under the other sky."""
    folder.mkdir()
    (folder / "mesh.obj").write_text(mesh())
    lights = exposure * irradiance(np.random.default_rng(11))
    frames = []
    for index in range(photos):
        turn = 2.0 * np.pi * index / photos
        aside = np.array([np.cos(turn), np.sin(turn)])
        eye = np.array([*(0.5 + 0.35 * aside), 1.5])
        pose = look_at(eye, np.array([*(0.5 - 0.15 * aside), 0.2]))
        write_png(folder / f"{index}.png", photograph(pose, lights[index % 2]))
        frames.append(Frame(folder / f"{index}.png", CAMERA, pose))
    write_scene(folder, Scene(folder / "transforms.json", folder / "mesh.obj", frames))
    return folder
