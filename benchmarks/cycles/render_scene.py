"""Render a GigaLit-style scene folder with Cycles: photos under several lightings, and the truth.

    python benchmarks/cycles/render_scene.py OUT [--mesh M --texture T] [--photos 40] ...

Runs in an environment with bpy. Without a mesh it renders the demo's own object. Each photo has a
camera of its own on the upper hemisphere, one of a few lightings (HDRI, rotation, perhaps a sun lamp)
and an exposure of its own. Files that exist are kept, so an interrupted run goes on where it stopped.

    OUT/transforms_train.json  train/NNN.png                       the photos, sRGB with alpha
    OUT/transforms_test.json   test/albedo_NNN.png                 true albedo in other views
                               test/relit_HDRI_NNN.png             the same views under held-out HDRIs
    OUT/mesh.obj  OUT/albedo_gt.png  OUT/truth.json                Z up, in the cameras' own space
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

import bpy  # isort: skip

import demo_object
from lights import Lighting, find_hdris
from studio import (
    LUMINANCE,
    albedo_material,
    lit_material,
    load_mesh,
    open_studio,
    photograph,
    quiet,
    set_lighting,
    shipped_hdris,
    sky_irradiance,
    wear,
)

FOV = 0.6911111611634243  # of the NeRF synthetic scenes
GREY = 0.28  # where a camera's meter puts the mean of what it sees, linear


def main() -> None:
    options = parse(sys.argv[1:])
    out = options.out.resolve()
    settings = {key: str(value) for key, value in sorted(vars(options).items()) if key != "out"}
    begin(out, settings)

    open_studio(options.size, FOV, options.samples)
    thing, texture = subject(options, out)
    lit, plain = lit_material(texture, options.roughness, options.specular), albedo_material(texture)
    hdris = find_hdris(options.hdris or shipped_hdris())
    held_out = options.held_out or list(hdris)[-2:]
    training = options.train_hdris or [name for name in hdris if name not in held_out]

    random = np.random.default_rng(options.seed)
    lights = [lighting(random, name) for name in cycle(training, options.lightings)]
    for index in range(round(options.suns * len(lights))):
        lights[index] = with_sun(random, lights[index], sky_irradiance(hdris[lights[index].hdri]))
    relights = [lighting(random, name) for name in held_out]
    if options.suns > 0.0:
        relights[0] = with_sun(random, relights[0], sky_irradiance(hdris[relights[0].hdri]))
    meter = GREY / mean_albedo(texture)
    light_gains = [meter * math.pi / level(light, hdris) for light in lights]
    relight_gains = [meter * math.pi / level(light, hdris) for light in relights]

    centre, radius = bounding_sphere(thing)
    photos = cameras(random, options.photos, centre, radius)
    chosen = random.permutation(np.arange(options.photos) % len(lights))
    gains = [light_gains[k] * 2.0 ** random.uniform(-options.stops, options.stops) for k in chosen]
    views = cameras(random, options.test, centre, radius)

    write_json(
        out / "transforms_train.json",
        transforms(options.size, [entry(f"train/{i:03}.png", pose) for i, pose in enumerate(photos)]),
    )
    relit_names = [light.hdri for light in relights]
    frames = []
    for index, pose in enumerate(views):
        relit = {name: f"test/relit_{name}_{index:03}.png" for name in relit_names}
        frames.append({**entry(f"test/albedo_{index:03}.png", pose), "relit": relit})
        if index >= options.relit_views:
            del frames[-1]["relit"]
    relit_gain = dict(zip(relit_names, relight_gains, strict=True))
    write_json(out / "transforms_test.json", {**transforms(options.size, frames), "relit_gain": relit_gain})

    jobs = []  # (file, pose, material, lighting, gain), grouped by lighting: changing it is what costs
    for index in np.argsort(chosen, kind="stable"):
        jobs.append((f"train/{index:03}.png", photos[index], lit, lights[chosen[index]], gains[index]))
    for frame, pose in zip(frames, views, strict=True):
        jobs.append((frame["file_path"], pose, plain, None, 1.0))
    for light, gain in zip(relights, relight_gains, strict=True):
        for frame, pose in zip(frames[: options.relit_views], views, strict=False):
            jobs.append((frame["relit"][light.hdri], pose, lit, light, gain))
    shoot(out, thing, jobs, hdris, options.albedo_samples, options.seed)

    write_json(
        out / "truth.json",
        {
            "settings": settings,
            "lights": [asdict(light) for light in lights],
            "train": [{"light": int(k), "gain": gain} for k, gain in zip(chosen, gains, strict=True)],
            "relights": [asdict(light) for light in relights],
        },
    )


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("out", type=Path)
    add("--mesh", type=Path, help="OBJ, PLY or GLB with UVs; without it, the demo's own object")
    add("--texture", type=Path, help="the mesh's true albedo; without it, the mesh's own base colour image")
    add("--texture-size", type=int, help="resample the true texture if its longer side has more texels")
    add("--up", choices=("Y", "Z"), default="Y", help="the mesh file's up axis (OBJ and PLY)")
    add("--photos", type=int, default=40)
    add("--test", type=int, default=8, help="test views")
    add("--relit-views", type=int, default=1000, help="test views also rendered under the held-out HDRIs")
    add("--size", type=int, default=512, help="pixels on a side")
    add("--samples", type=int, default=64, help="a pixel; denoised")
    add("--albedo-samples", type=int, default=16, help="a pixel of the albedo views")
    add("--lightings", type=int, default=5)
    add("--suns", type=float, default=0.4, help="share of the lightings that have a sun lamp")
    add("--stops", type=float, default=0.6, help="exposure of each photo, plus or minus")
    add("--hdris", type=Path, help="folder of .exr and .hdr files; without it, those that ship with Blender")
    add("--train-hdris", nargs="+", help="names; without them, all that are not held out")
    add("--held-out", nargs="+", help="names of the HDRIs to relight under; without them, the last two")
    add("--roughness", type=float, default=1.0)
    add("--specular", type=float, default=0.0)
    add("--seed", type=int, default=0)
    return parser.parse_args(arguments)


def begin(out: Path, settings: dict[str, str]) -> None:
    """Make the folders; a folder made with other settings is not mixed with these."""
    for folder in ("train", "test"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    noted = out / "settings.json"
    if noted.exists() and json.loads(noted.read_text()) != settings:
        sys.exit(f"{out}: was rendered with other settings; name another folder or remove this one.")
    write_json(noted, settings)


def subject(options: argparse.Namespace, out: Path) -> tuple[bpy.types.Object, bpy.types.Image]:
    """The object and its albedo texture, both also written to `out`."""
    if options.mesh is None:
        thing, texture = demo_object.build()
    else:
        thing = load_mesh(options.mesh, options.up)
        if not thing.data.uv_layers:
            sys.exit(f"{options.mesh}: has no UVs; unwrap it first.")
        texture = bpy.data.images.load(str(options.texture)) if options.texture else own_texture(thing)
    if not len(texture.pixels):  # asking loads the file; after its path is changed it would be too late
        sys.exit(f"{options.texture or options.mesh}: its texture cannot be read.")
    shrink(texture, options.texture_size)
    print(f"true texture: {texture.size[0]} x {texture.size[1]}", flush=True)
    texture.filepath_raw, texture.file_format = str(out / "albedo_gt.png"), "PNG"
    texture.save()
    bpy.ops.object.select_all(action="DESELECT")
    thing.select_set(True)
    with quiet():
        bpy.ops.wm.obj_export(
            filepath=str(out / "mesh.obj"),
            export_selected_objects=True,
            export_triangulated_mesh=True,
            export_materials=False,
            forward_axis="Y",
            up_axis="Z",
        )
    return thing, texture


def shrink(texture: bpy.types.Image, limit: int | None) -> None:
    """Resample so that the longer side has `limit` texels; never enlarge."""
    width, height = texture.size
    if limit and max(width, height) > limit:
        scale = limit / max(width, height)
        texture.scale(max(1, round(width * scale)), max(1, round(height * scale)))


def own_texture(thing: bpy.types.Object) -> bpy.types.Image:
    images = {
        link.from_node.image
        for material in thing.data.materials
        for link in material.node_tree.links
        if link.to_socket.name == "Base Color" and link.from_node.type == "TEX_IMAGE"
    }
    if len(images) != 1:
        sys.exit(f"the mesh has {len(images)} base colour images; name its one texture with --texture.")
    return images.pop()


def mean_albedo(texture: bpy.types.Image) -> float:
    """Luminance of the texture's mean, linear; texels outside the islands count too, which is near enough."""
    pixels = np.empty(texture.size[0] * texture.size[1] * 4, np.float32)
    texture.pixels.foreach_get(pixels)
    encoded = pixels.reshape(-1, 4)[:, :3]
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return float(linear.mean(axis=0) @ LUMINANCE)


def cycle(names: list[str], count: int) -> list[str]:
    return [names[index % len(names)] for index in range(count)]


def lighting(random: np.random.Generator, name: str) -> Lighting:
    return Lighting(name, float(random.uniform(0.0, 2.0 * math.pi)))


def with_sun(random: np.random.Generator, light: Lighting, sky: float) -> Lighting:
    """`light` with a sun lamp some times as bright as its sky, where the light comes from above."""
    return replace(
        light,
        sun_irradiance=float(sky * random.uniform(1.5, 3.0)),
        sun_azimuth=float(random.uniform(0.0, 2.0 * math.pi)),
        sun_elevation=float(math.radians(random.uniform(25.0, 60.0))),
    )


def level(light: Lighting, hdris: dict[str, Path]) -> float:
    """Irradiance of level ground."""
    return sky_irradiance(hdris[light.hdri]) + light.sun_irradiance * math.sin(light.sun_elevation)


def bounding_sphere(thing: bpy.types.Object) -> tuple[np.ndarray, float]:
    points = np.empty(len(thing.data.vertices) * 3, np.float32)
    thing.data.vertices.foreach_get("co", points)
    points = points.reshape(-1, 3).astype(np.float64)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def cameras(random: np.random.Generator, count: int, centre: np.ndarray, radius: float) -> list[np.ndarray]:
    """Camera-to-world poses on the upper hemisphere, spread by the golden angle and then disturbed."""
    poses = []
    start = random.uniform(0.0, 2.0 * math.pi)
    for index in random.permutation(count):
        azimuth = start + index * math.pi * (3.0 - math.sqrt(5.0)) + random.normal(0.0, 0.15)
        height = math.sin(math.radians(75.0)) * (index + random.uniform()) / count
        elevation = math.asin(height) + math.radians(3.0)
        distance = radius / math.sin(0.5 * FOV) * random.uniform(0.9, 1.2)
        towards = np.array(
            [
                math.cos(azimuth) * math.cos(elevation),
                math.sin(azimuth) * math.cos(elevation),
                math.sin(elevation),
            ]
        )
        target = centre + random.normal(0.0, 0.03 * radius, 3)
        right = np.cross([0.0, 0.0, 1.0], towards)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([right, np.cross(towards, right), towards])
        pose[:3, 3] = target + distance * towards
        poses.append(pose)
    return poses


def shoot(out: Path, thing, jobs: list, hdris: dict[str, Path], albedo_samples: int, seed: int) -> None:
    """Render every job whose file is not there yet."""
    hung = None
    for number, (name, pose, material, light, gain) in enumerate(jobs, 1):
        if (out / name).exists():
            continue
        print(f"[{number}/{len(jobs)}] {name}", flush=True)
        if list(thing.data.materials) != [material]:
            wear(thing, material)
        if light is not None and light != hung:
            set_lighting(light, hdris)
            hung = light
        photograph(out / name, pose, gain, albedo_samples if light is None else None, seed + number)


def transforms(size: int, frames: list[dict]) -> dict:
    return {"camera_angle_x": FOV, "w": size, "h": size, "frames": frames}


def entry(name: str, pose: np.ndarray) -> dict:
    return {"file_path": name, "transform_matrix": pose.tolist()}


def write_json(path: Path, content: object) -> None:
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(content, indent=1), encoding="utf-8")
    partial.replace(path)


if __name__ == "__main__":
    main()
