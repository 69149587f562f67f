"""Files that are cut, that lie, that are huge, that lead elsewhere; and odd names, with which all has to work."""

from __future__ import annotations

import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from dante_w.scene.images import write_exr, write_png

from extremes.fuzz import colmap_binary, colmap_text, glb, pack_glb, ply_ascii, ply_binary
from extremes.provoke import SIZE, Stand, judged, run, tried
from extremes.row import Row

HUGE = 60_000
ODD_NAMES = (
    "with space",
    'it\'s "quoted"',
    "line\nbreak",
    "häß日本語🏺",
    "-dash",
    "%d #1 $HOME `x`;&",
    "a" * 200,
)

#: Spoils a scene folder; returns further options.
Spoil = Callable[[Path], "list[str | Path] | None"]


def rows(place: Stand, progress: Callable[[str], None]) -> Iterator[Row]:
    for name, (words, spoil) in cases(place).items():
        progress(name)
        yield tried(name, partial(_refused, place, name, words, spoil))
    for odd in ODD_NAMES:
        name = f"folders and files named {json.dumps(odd[:24], ensure_ascii=False)}"
        progress(name)
        yield tried(name, partial(_odd_name, place, name, odd))
    name = "a whole PNG of 16,000 x 16,000 pixels in 1 MB, as its camera says, in 4 GiB of address space"
    progress(name)
    yield tried(name, partial(_bomb, place, name))


def _refused(place: Stand, name: str, words: str, spoil: Spoil) -> Row:
    scene = place.scene_copy("spoilt")
    place.fresh()
    more = spoil(scene) or []
    found = run("average", scene, "--out", place.out, *SIZE, *more)
    return judged(name, 2, found, place, words)


def _odd_name(place: Stand, name: str, odd: str) -> Row:
    """Scene, photo, mesh and result bear the name."""
    parent = place.folder / odd
    scene = parent / "scene"
    shutil.rmtree(parent, ignore_errors=True)
    shutil.copytree(place.scene, scene)
    (scene / "000.exr").rename(scene / f"{odd}.exr")
    (scene / "mesh.obj").rename(scene / f"{odd}.obj")
    edit(
        scene,
        lambda content: (
            content.update(mesh_path=f"{odd}.obj"),
            content["frames"][0].update(file_path=f"{odd}.exr"),
        ),
    )
    found = run("average", scene, "--out", parent / "out", *SIZE)
    same = all(
        (parent / "out" / own).is_file()
        and (parent / "out" / own).read_bytes() == (place.folder / "former" / own).read_bytes()
        for own in ("albedo.png", "coverage.png")
    )
    told = f"exit {found.code}, {'the same' if same else 'ANOTHER'} result"
    return Row(name, "faults", told, "exit 0, the same result", found.code == 0 and same, found.sentence)


def _bomb(place: Stand, name: str) -> Row:
    """Nothing about it is wrong but its size."""
    scene, side = place.scene_copy("spoilt"), 16_000
    place.fresh()
    (scene / "bomb.png").write_bytes(png(side, side, zeros((3 * side + 1) * side)))
    edit(scene, lambda whole: whole["frames"][0].update(file_path="bomb.png", w=side, h=side))
    found = run("average", scene, "--out", place.out, *SIZE, before=["prlimit", f"--as={4 << 30}"])
    return judged(name, 4, found, place, "memory")


def edit(scene: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change a scene's transforms.json."""
    file = scene / "transforms.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    change(content)
    file.write_text(json.dumps(content), encoding="utf-8")


def png(width: int, height: int, body: bytes) -> bytes:
    """A PNG whose header says so, whatever its body holds."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def zeros(count: int) -> bytes:
    """A zlib stream of so many zeros, made of equal blocks in a moment."""

    def block(size: int, end: int) -> bytes:
        packer = zlib.compressobj(9, zlib.DEFLATED, -15)
        return packer.compress(bytes(size)) + packer.flush(end)

    size = 1 << 20
    whole, rest = divmod(count, size)
    body = block(size, zlib.Z_FULL_FLUSH) * whole + block(rest, zlib.Z_FINISH)
    return b"\x78\x01" + body + struct.pack(">HH", count % 65521, 1)  # Adler-32 of zeros


def huge_exr(path: Path, side: int) -> bytes:
    """A small EXR whose windows say that it is side x side, with as many lines as that in its table."""
    write_exr(path, np.zeros((16, 16, 3), np.float16))
    content = path.read_bytes()
    small, large = struct.pack("<4i", 0, 0, 15, 15), struct.pack("<4i", 0, 0, side - 1, side - 1)
    assert content.count(small) == 2
    head = content.replace(small, large)
    return head + bytes(8 * (side // 16) + 300_000)


def cases(place: Stand) -> dict[str, tuple[str, Spoil]]:
    """By name: what the sentence must hold, and how a scene folder is spoilt."""
    found: dict[str, tuple[str, Spoil]] = {}

    def photo(name: str, words: str, content: Callable[[Path], bytes], ending: str = "png") -> None:
        def spoil(scene: Path) -> None:
            target = scene / f"bad.{ending}"
            target.write_bytes(content(target))
            edit(scene, lambda whole: whole["frames"][0].update(file_path=target.name))

        found[name] = (words, spoil)

    def cut(share: float) -> Callable[[Path], bytes]:
        def content(target: Path) -> bytes:
            pixels = np.random.default_rng(0).random((96, 96, 3))
            if target.suffix == ".exr":
                write_exr(target, pixels.astype(np.float16))
            elif target.suffix == ".png":
                write_png(target, (255 * pixels).astype(np.uint8))
            else:
                import OpenImageIO as oiio  # noqa: N813

                picture = oiio.ImageOutput.create(str(target))
                picture.open(str(target), oiio.ImageSpec(96, 96, 3, "uint8"))
                picture.write_image((255 * pixels).astype(np.uint8))
                picture.close()
            whole = target.read_bytes()
            return whole[: int(share * len(whole))]

        return content

    for ending in ("png", "jpg", "tif", "exr"):
        for share in (0.02, 0.5, 0.95):
            photo(f"{ending.upper()} cut to {share:.0%}", "bad", cut(share), ending)
    photo(
        "PNG header of 60,000 x 60,000 over nothing", "bad.png", lambda _: png(HUGE, HUGE, zlib.compress(b""))
    )
    photo(
        "PNG of 60,000 x 60,000, body of 10 MB of zeros",
        "bad.png",
        lambda _: png(HUGE, HUGE, zlib.compress(bytes(10**7))),
    )
    photo("whole PNG of 60,000 x 60,000", "bad.png", lambda _: png(HUGE, HUGE, zeros((3 * HUGE + 1) * HUGE)))
    photo("PNG header of 96 x 96 over one line", "bad.png", lambda _: png(96, 96, zlib.compress(bytes(289))))
    photo("PNG of 2^31 - 1 pixels a side", "bad.png", lambda _: png(2**31 - 1, 2**31 - 1, zlib.compress(b"")))
    photo("PNG of no width", "bad.png", lambda _: png(0, 96, zlib.compress(b"")))
    photo("EXR of 60,000 x 60,000 in 300 kB", "bad.exr", lambda target: huge_exr(target, HUGE), "exr")
    photo(
        "EXR header of 16,000 x 16,000 in 300 kB", "bad.exr", lambda target: huge_exr(target, 16_000), "exr"
    )
    photo(
        "photo of another size than its camera",
        "96 x 96",
        lambda _: png(50, 40, zlib.compress(bytes(40 * 151))),
    )
    photo("photo that is a text", "bad.png", lambda _: b"not a picture")
    photo("empty photo", "bad.png", lambda _: b"")

    def mesh(name: str, words: str, content: bytes, ending: str = "obj") -> None:
        def spoil(scene: Path) -> list[str | Path]:
            (scene / f"other.{ending}").write_bytes(content)
            return ["--mesh", scene / f"other.{ending}"]

        found[name] = (words, spoil)

    obj = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    mesh("OBJ that is a photo", "other.obj", png(8, 8, b""))
    mesh("OBJ without faces", "no faces", obj)
    mesh("OBJ with an index out of range", "other.obj", obj + b"f 1/1 2/2 9/3\n")
    mesh("OBJ with a negative index out of range", "other.obj", obj + b"f -1/1 -2/2 -9/3\n")
    mesh("OBJ with index 0", "other.obj", obj + b"f 0/1 1/2 2/3\n")
    mesh("OBJ with a NaN vertex", "not finite", obj.replace(b"v 1 0 0", b"v nan 0 0") + b"f 1/1 2/2 3/3\n")
    mesh("OBJ with an infinite UV", "not finite", obj.replace(b"vt 1 0", b"vt 1e400 0") + b"f 1/1 2/2 3/3\n")
    mesh("OBJ with an index of 10^30", "other.obj", obj + b"f 1/1 2/2 1000000000000000000000000000000/3\n")
    for count in (b"4000000000", b"9" * 30):
        said = f"PLY that says {len(count)} digits of vertices"
        mesh(said, "other.ply", ply_ascii().replace(b"vertex 4", b"vertex " + count), "ply")
        mesh(f"{said}, binary", "other.ply", ply_binary().replace(b"face 2", b"face " + count), "ply")
    mesh("PLY with a list of 255 corners in no file", "other.ply", ply_binary()[:-30] + b"\xff" * 30, "ply")
    mesh("PLY cut in half", "other.ply", ply_binary()[: len(ply_binary()) // 2], "ply")
    document = glb()
    mesh("GLB cut in half", "other.glb", document[: len(document) // 2], "glb")
    for was, now in ((b'"count": 6', b'"count": 6000000000'), (b'"byteLength": 12}', b'"byteLength": 4}'),
                     (b'"byteOffset": 80', b'"byteOffset": -8'), (b'"byteOffset": 0', b'"byteOffset": 1e18'),
                     (b'"children": [1]', b'"children": [0]'), (b'"POSITION": 0', b'"POSITION": 77')):  # fmt: skip
        (length,) = struct.unpack_from("<I", document, 12)
        text = document[20 : 20 + length]
        assert was in text, was
        mesh(
            f"GLB with {now.decode()}",
            "other.glb",
            pack_glb(text.replace(was, now, 1), document[28 + length :]),
            "glb",
        )
    mesh("GLB nested 100,000 deep", "other.glb", pack_glb(b"[" * 100_000, b""), "glb")
    found["a mesh that is not there"] = ("other.obj", lambda scene: ["--mesh", scene / "other.obj"])
    found["a mesh that is a folder"] = (
        "images.obj",
        lambda scene: (scene / "images.obj").mkdir() or ["--mesh", scene / "images.obj"],
    )

    def scene_file(name: str, words: str, change: Callable[[dict[str, Any]], object]) -> None:
        found[name] = (words, lambda scene: edit(scene, change))

    for key in ("file_path", "mask_path", "albedo_path"):
        for target in (
            "/etc/passwd",
            "../former/albedo.png",
            "x/../../former/albedo.png",
            "C:\\x.png",
            "\\\\host\\x.png",
        ):

            def lead(whole: dict[str, Any], key: str = key, target: str = target) -> None:
                whole["frames"][1][key] = target

            scene_file(f"{key} is {target}", "" if "\\" in target else "outside", lead)
    scene_file(
        "mesh_path is an absolute path",
        "outside",
        lambda whole: whole.update(mesh_path=str(place.scene / "mesh.obj")),
    )
    scene_file(
        "a pose of NaN",
        "pose",
        lambda whole: whole["frames"][0]["transform_matrix"][0].__setitem__(0, float("nan")),
    )
    scene_file("a focal length of 1e400", "fl_x", lambda whole: whole["frames"][0].update(fl_x=float("inf")))
    scene_file("an image width of 10^300", "size", lambda whole: whole["frames"][0].update(w=1e300))
    scene_file("frames that are no list", "frames", lambda whole: whole.update(frames={"a": 1}))
    scene_file(
        "a photo's name that is a number", "file_path", lambda whole: whole["frames"][0].update(file_path=7)
    )

    def nested(scene: Path) -> None:
        (scene / "transforms.json").write_text('{"frames": ' + "[" * 200_000)

    found["transforms.json nested 200,000 deep"] = ("transforms.json", nested)

    def twice(scene: Path) -> None:
        text = (scene / "transforms.json").read_text()
        (scene / "transforms.json").write_text(
            '{"frames": [{"file_path": "000.exr"}], ' + text.strip()[1:-1] + ', "frames": []}'
        )

    found["frames named twice: the last counts"] = ("no frames", twice)

    def link(name: str, words: str, make: Callable[[Path], object]) -> None:
        found[name] = (words, lambda scene: make(scene) and None)

    def out_of(scene: Path) -> None:
        (scene / "000.exr").unlink()
        (scene / "000.exr").symlink_to(place.scene / "000.exr")

    def loop(scene: Path) -> None:
        (scene / "000.exr").unlink()
        (scene / "000.exr").symlink_to(scene / "loop.exr")
        (scene / "loop.exr").symlink_to(scene / "000.exr")

    def mesh_out(scene: Path) -> None:
        edit(scene, lambda whole: whole.pop("mesh_path", None))
        (scene / "mesh.obj").unlink()
        (scene / "mesh.obj").symlink_to(place.scene / "mesh.obj")

    link("a photo that is a link out of the scene", "outside", out_of)
    link("a loop of links", "000.exr", loop)
    link("a mesh that is a link out of the scene", "--mesh", mesh_out)

    def colmap(
        name: str, words: str, files: dict[str, bytes], prepare: Callable[[Path], object] = lambda _: None
    ) -> None:
        def spoil(scene: Path) -> None:
            (scene / "transforms.json").unlink()
            (scene / "sparse/0").mkdir(parents=True)
            (scene / "images").mkdir()
            for own, content in files.items():
                (scene / "sparse/0" / own).write_bytes(content)
            prepare(scene)

        found[name] = (words, spoil)

    text, binary = colmap_text(), colmap_binary()
    for share in (0.0, 0.3, 0.9):
        for kind, files in (("text", text), ("binary", binary)):
            for own in files:
                content = files[own][: int(share * len(files[own]))]
                colmap(f"COLMAP {kind}, {own} cut to {share:.0%}", "", {**files, own: content})
    counts = struct.pack("<Q", 2**62)
    colmap(
        "COLMAP cameras.bin that says 2^62 cameras",
        "damaged",
        {**binary, "cameras.bin": counts + binary["cameras.bin"][8:]},
    )
    colmap(
        "COLMAP images.bin that says 2^62 photos",
        "damaged",
        {**binary, "images.bin": counts + binary["images.bin"][8:]},
    )
    colmap(
        "COLMAP with a photo named ../000.exr",
        "leads out",
        {**text, "images.txt": b"1 1 0 0 0 0 0 0 1 ../000.exr\n\n"},
    )
    colmap(
        "COLMAP with a photo named /etc/passwd",
        "leads out",
        {**text, "images.txt": b"1 1 0 0 0 0 0 0 1 /etc/passwd\n\n"},
    )

    def images_out(scene: Path) -> None:
        (scene / "images").rmdir()
        os.symlink(place.scene, scene / "images")

    colmap("COLMAP with images/ a link out of the scene", "--images", text, images_out)
    one = {**text, "images.txt": b"1 1 0 0 0 0 0 0 1 a.exr\n\n"}
    colmap(
        "COLMAP with a photo that is a link out of images/", "link", one,
        lambda scene: (scene / "images/a.exr").symlink_to(place.scene / "000.exr"),
    )  # fmt: skip
    return found
