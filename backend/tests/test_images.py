import os
import struct
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from dante_w.contract.errors import BadInput, DanteError, OutOfRoom
from dante_w.core.color import linear_from_srgb_array, srgb_from_linear_array
from dante_w.scene import images
from dante_w.scene.images import read_header, read_photo, read_prior, read_texture, write_exr, write_png
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

in_one_folder = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=80
)
KINDS = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}


def save(path: Path, pixels: np.ndarray, **attributes: object) -> Path:
    """Write with OpenImageIO directly; `a__b` stands for the attribute a:b, `full` for the display window."""
    pixels = np.ascontiguousarray(pixels)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], KINDS[pixels.dtype.name])
    for name, value in attributes.items():
        if name == "full":
            spec.x, spec.y, spec.full_width, spec.full_height = value
        else:
            spec.attribute(name.replace("__", ":"), value)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec) and target.write_image(pixels) and target.close()
    return path


def noise(height: int, width: int, channels: int, kind: str = "uint8") -> np.ndarray:
    rng = np.random.default_rng(height * width + channels)
    if kind.startswith("float"):
        return (4.0 * rng.random((height, width, channels))).astype(kind)
    return rng.integers(0, np.iinfo(kind).max, (height, width, channels), kind, endpoint=True)


def size(path: Path) -> tuple[int, int]:
    header = read_header(path)
    return header.width, header.height


@pytest.mark.parametrize("ending", ["png", "tif"])
@pytest.mark.parametrize("kind", ["uint8", "uint16"])
def test_integers_are_divided_by_their_largest(tmp_path, ending, kind):
    pixels = noise(5, 7, 3, kind)
    photo = read_photo(save(tmp_path / f"a.{ending}", pixels))
    assert photo.srgb.dtype == np.float32 and photo.foreground.all() and photo.foreground.shape == (5, 7)
    np.testing.assert_allclose(photo.srgb, pixels / np.float64(np.iinfo(kind).max), atol=1e-7)


def test_jpeg_is_read_as_stored_whatever_its_orientation(tmp_path):
    pixels = np.zeros((16, 32, 3), np.uint8)
    pixels[:8, :16] = 255
    path = save(tmp_path / "a.jpg", pixels, Orientation=6, Compression="jpeg:100")
    assert size(path) == (32, 16)
    np.testing.assert_allclose(read_photo(path).srgb, pixels / 255.0, atol=0.02)


def test_grey_becomes_three_channels(tmp_path):
    pixels = noise(4, 6, 1)
    srgb = read_photo(save(tmp_path / "a.png", pixels)).srgb
    np.testing.assert_allclose(srgb, np.repeat(pixels / 255.0, 3, axis=2), atol=1e-7)


def test_grey_with_alpha(tmp_path):
    pixels = noise(4, 6, 2)
    pixels[:, :, 1] = np.where(np.arange(24).reshape(4, 6) % 2, 255, 0)
    photo = read_photo(save(tmp_path / "a.png", pixels, oiio__UnassociatedAlpha=1))
    assert (photo.foreground == (pixels[:, :, 1] == 255)).all()
    np.testing.assert_allclose(photo.srgb[:, :, 2], pixels[:, :, 0] / 255.0, atol=1e-7)


@pytest.mark.parametrize("ending", ["png", "tif"])
def test_alpha_is_straight_and_cut_at_95_percent(tmp_path, ending):
    pixels = noise(2, 4, 4)
    pixels[:, :, 3] = [[0, 128, 242, 243], [254, 255, 1, 200]]  # 0.95 lies between 242 and 243
    photo = read_photo(save(tmp_path / f"a.{ending}", pixels, oiio__UnassociatedAlpha=1))
    assert photo.foreground.tolist() == [[False, False, False, True], [True, True, False, False]]
    np.testing.assert_allclose(photo.srgb, pixels[:, :, :3] / 255.0, atol=1e-7)


def test_alpha_of_a_prior_is_how_far_it_is_to_be_trusted(tmp_path):
    pixels = noise(1, 4, 4)
    pixels[0, :, 3] = [0, 51, 128, 255]
    prior = read_prior(save(tmp_path / "a.png", pixels, oiio__UnassociatedAlpha=1))
    assert np.isnan(prior[0, 0]).all()
    np.testing.assert_allclose(prior[0, 1:], pixels[0, 1:] / 255.0, atol=1e-7)


def test_premultiplied_float_colours_are_divided_by_alpha(tmp_path):
    pixels = np.array([[[0.48, 0.24, 0.12, 0.96], [2.0, 1.0, 0.5, 1.0], [0.3, 0.0, 0.0, 0.0]]], np.float32)
    linear = read_texture(save(tmp_path / "a.exr", pixels))
    np.testing.assert_allclose(linear, [[[0.5, 0.25, 0.125], [2.0, 1.0, 0.5], [0.3, 0.0, 0.0]]], rtol=1e-6)


@pytest.mark.parametrize("kind", ["float16", "float32"])
def test_float_photos_are_encoded_and_keep_what_is_brighter_than_white(tmp_path, kind):
    pixels = noise(5, 3, 3, kind)
    path = save(tmp_path / "a.exr", pixels)
    srgb = read_photo(path).srgb
    assert srgb.max() > 1.0
    np.testing.assert_allclose(srgb, srgb_from_linear_array(pixels.astype(np.float32)), atol=1e-6)
    np.testing.assert_array_equal(read_texture(path), pixels.astype(np.float32))


def test_radiance_hdr_is_linear(tmp_path):
    pixels = np.full((4, 4, 3), 2.0, np.float32)
    np.testing.assert_allclose(read_texture(save(tmp_path / "a.hdr", pixels)), pixels, rtol=0.01)


def test_textures_are_decoded_from_srgb(tmp_path):
    pixels = noise(5, 7, 3)
    linear = read_texture(save(tmp_path / "a.png", pixels))
    np.testing.assert_allclose(linear, linear_from_srgb_array(pixels.astype(np.float32) / 255), atol=1e-6)


def test_pixels_that_are_not_finite_are_no_foreground(tmp_path):
    pixels = np.ones((2, 3, 3), np.float32)
    pixels[0, 0, 1], pixels[1, 2, 0], pixels[0, 2, 2] = np.nan, np.inf, -np.inf
    pixels[1, 0, 1] = -1e38  # finite, but not once encoded
    photo = read_photo(save(tmp_path / "a.exr", pixels))
    assert photo.foreground.tolist() == [[False, True, False], [False, True, False]]
    assert (photo.srgb[~photo.foreground] == 0.0).all() and np.isfinite(photo.srgb).all()


def test_the_display_window_is_the_picture(tmp_path):
    pixels = noise(2, 3, 3, "float32")
    path = save(tmp_path / "crop.exr", pixels, full=(1, 2, 5, 6))
    expected = np.zeros((6, 5, 3), np.float32)
    expected[2:4, 1:4] = pixels
    assert size(path) == (5, 6)
    np.testing.assert_array_equal(read_texture(path), expected)
    path = save(tmp_path / "overscan.exr", pixels, full=(-1, -1, 1, 1))
    np.testing.assert_array_equal(read_texture(path), pixels[1:2, 1:2])
    path = save(tmp_path / "apart.exr", pixels, full=(9, 9, 2, 2))
    np.testing.assert_array_equal(read_texture(path), np.zeros((2, 2, 3)))


def test_a_mask_joins_alpha(tmp_path):
    pixels = np.full((1, 4, 4), 255, np.uint8)
    pixels[0, 3, 3] = 0
    photo = save(tmp_path / "a.png", pixels, oiio__UnassociatedAlpha=1)
    mask = save(tmp_path / "m.png", np.array([[[127], [128], [0], [255]]], np.uint8))
    assert read_photo(photo, mask).foreground.tolist() == [[False, True, False, False]]


def test_a_mask_of_another_size_is_refused(tmp_path):
    photo, mask = save(tmp_path / "a.png", noise(4, 6, 3)), save(tmp_path / "m.png", noise(6, 4, 1))
    with pytest.raises(BadInput, match="4 x 6 pixels but its photo is 6 x 4"):
        read_photo(photo, mask)


@pytest.mark.parametrize("ending", ["png", "jpg", "tif", "exr", "hdr", "webp"])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 0.6, 0.9, 0.97])
def test_cut_files_are_refused(tmp_path, ending, share):
    whole = save(
        tmp_path / f"whole.{ending}", noise(40, 40, 3, "float32" if ending in ("exr", "hdr") else "uint8")
    )
    assert read_photo(whole).srgb.shape == (40, 40, 3)
    content = whole.read_bytes()
    cut = tmp_path / f"cut.{ending}"
    cut.write_bytes(content[: int(share * len(content))])
    with pytest.raises(BadInput, match="cut") as caught:
        read_photo(cut)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("ending", ["png", "jpg", "tif", "exr", "hdr"])
def test_damaged_files_read_or_are_refused(tmp_path, ending):
    kind = "float32" if ending in ("exr", "hdr") else "uint8"
    content = save(tmp_path / f"whole.{ending}", noise(12, 12, 3, kind)).read_bytes()
    path = tmp_path / f"damaged.{ending}"

    @in_one_folder
    @given(st.lists(st.tuples(st.integers(0, len(content) - 1), st.integers(0, 255)), min_size=1, max_size=4))
    def check(changes):
        changed = bytearray(content)
        for place, value in changes:
            changed[place] = value
        path.write_bytes(changed)
        try:
            photo = read_photo(path)
        except DanteError:
            return
        assert np.isfinite(photo.srgb).all() and photo.srgb.shape == (*photo.foreground.shape, 3)

    check()


@in_one_folder
@given(st.binary(max_size=200), st.sampled_from(["png", "jpg", "tif", "exr", "hdr", "webp", "", "xyz"]))
def test_random_bytes_are_refused(tmp_path, content, ending):
    path = tmp_path / f"random.{ending}"
    path.write_bytes(content)
    for read in (read_header, read_photo, read_texture):
        with pytest.raises(BadInput):
            read(path)


def png_of_size(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b""))
        + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize("padding", [0, 2**28])  # OpenImageIO itself refuses what is far larger than its file
def test_absurd_sizes_are_refused_from_the_header(tmp_path, padding):
    path = tmp_path / "bomb.png"
    path.write_bytes(png_of_size(25_000, 24_000))
    os.truncate(path, path.stat().st_size + padding)  # sparse
    for read in (read_header, read_photo):
        with pytest.raises(BadInput, match="25000 x 24000" if padding else "malicious"):
            read(path)


def test_missing_files_and_folders_are_refused(tmp_path):
    for path in (tmp_path / "none.png", tmp_path):
        for read in (read_header, read_photo, read_texture):
            with pytest.raises(BadInput, match="no such image"):
                read(path)
    photo = save(tmp_path / "a.png", noise(2, 2, 3))
    with pytest.raises(BadInput, match="none"):
        read_photo(photo, tmp_path / "none.png")


def test_other_formats_are_refused(tmp_path):
    save(tmp_path / "a.ppm", noise(2, 2, 3))
    with pytest.raises(BadInput, match="save it as PNG"):
        read_photo(tmp_path / "a.ppm")
    (tmp_path / "a.null").touch()  # OpenImageIO makes up an image for such names
    with pytest.raises(BadInput):
        read_photo(tmp_path / "a.null")


@pytest.mark.parametrize("kind", ["uint8", "uint16"])
@pytest.mark.parametrize("shape", [(600, 5, 3), (3, 4), (1, 1, 3)])
def test_png_holds_every_bit(tmp_path, kind, shape):
    pixels = noise(shape[0], shape[1], 3, kind)[:, :, : 3 if len(shape) == 3 else 1].reshape(shape)
    write_png(tmp_path / "a.png", pixels)
    content = (tmp_path / "a.png").read_bytes()
    assert b"sRGB" in content
    assert content[24] == 8 * pixels.itemsize and content[25] == (2 if len(shape) == 3 else 0)
    back = read_photo(tmp_path / "a.png").srgb.astype(np.float64) * np.iinfo(kind).max
    np.testing.assert_array_equal(np.rint(back), np.broadcast_to(pixels.reshape(*shape[:2], -1), back.shape))


@pytest.mark.parametrize("kind", ["float16", "float32"])
def test_exr_holds_every_bit_of_a_mapped_array(tmp_path, kind):
    pixels = np.memmap(tmp_path / "pixels", kind, "w+", shape=(600, 7, 3))
    pixels[...] = noise(600, 7, 3, kind)
    write_exr(tmp_path / "a.exr", pixels)
    np.testing.assert_array_equal(read_texture(tmp_path / "a.exr"), pixels.astype(np.float32))
    spec = oiio.ImageInput.open(str(tmp_path / "a.exr")).spec()
    assert spec.format == (oiio.HALF if kind == "float16" else oiio.FLOAT)


@pytest.mark.parametrize(("write", "kind"), [(write_png, "uint8"), (write_exr, "float32")])
def test_a_full_disk_is_out_of_room(tmp_path, write, kind):
    if not Path("/dev/full").exists():
        pytest.skip("only Linux has /dev/full")
    path = tmp_path / ("a.png" if kind == "uint8" else "a.exr")
    path.symlink_to("/dev/full")
    for side in (4, 300):  # written at closing, and before
        with pytest.raises(OutOfRoom, match="disk space"):
            write(path, noise(side, side, 3, kind))


@pytest.mark.parametrize(("write", "kind"), [(write_png, "uint8"), (write_exr, "float32")])
def test_a_folder_that_is_not_there_is_bad_input(tmp_path, write, kind):
    with pytest.raises(BadInput, match="folder"):
        write(tmp_path / "none" / ("a.png" if kind == "uint8" else "a.exr"), noise(2, 2, 3, kind))


def test_other_types_are_a_mistake_of_the_program(tmp_path):
    with pytest.raises(TypeError):
        write_png(tmp_path / "a.png", np.zeros((2, 2, 3), np.float32))
    with pytest.raises(TypeError):
        write_exr(tmp_path / "a.exr", np.zeros((2, 2, 3), np.uint8))


def test_a_picture_that_needs_more_memory_than_is_free_is_refused_from_the_header(tmp_path, monkeypatch):
    path = save(tmp_path / "a.png", noise(40, 50, 3))
    free = images.psutil.virtual_memory()
    needed = images.BYTES_PER_SAMPLE * 40 * 50 * 3
    for available in (needed, needed - 1):
        monkeypatch.setattr(
            images.psutil, "virtual_memory", lambda value=available: free._replace(available=value)
        )
        if available == needed:
            assert read_photo(path).srgb.shape == (40, 50, 3)
        else:
            with pytest.raises(OutOfRoom, match="50 x 40"):
                read_photo(path)
