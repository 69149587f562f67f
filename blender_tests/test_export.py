"""What is written to the scene folder: the evaluated mesh, and every photo once."""

import os

import bpy
import numpy as np
import pytest
from dante_w_addon.contract.errors import BadInput
from dante_w_addon.contract.triangles import Triangles, read_obj, write_obj
from mathutils import Matrix
from small_scene import add_camera, add_cube, build, save_picture, set_photo

from dante_w_addon.blender import mesh, photos, uv_back
from dante_w_addon.bridge import export
from dante_w_addon.contract import scene_folder


def exported(obj, path):
    write_obj(path, mesh.evaluated_triangles(obj, bpy.context.evaluated_depsgraph_get()))
    read = read_obj(path)
    return read.vertices, read.uvs, read.corners, read.uv_corners


def area(vertices, corners):
    a, b, c = (vertices[corners[:, i]] for i in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def volume(vertices, corners):
    """Positive where the faces look outwards."""
    a, b, c = (vertices[corners[:, i]] for i in range(3))
    return (np.cross(a, b) * c).sum() / 6.0


def test_modifiers_are_applied(tmp_path):
    cube = add_cube()
    cube.modifiers.new("Bigger", "SUBSURF").levels = 2
    vertices, uvs, corners, uv_corners = exported(cube, tmp_path / "a.obj")
    assert len(corners) == 6 * 16 * 2
    assert uv_corners.max() < len(uvs) and uvs.min() >= 0.0 and uvs.max() <= 1.0
    assert volume(vertices, corners) < 8.0 - 1.0


def test_world_transform_is_applied(tmp_path):
    cube = add_cube()
    cube.matrix_world = Matrix.Translation((10.0, 0.0, 0.0)) @ Matrix.Diagonal((1.0, 2.0, 3.0, 1.0))
    vertices, _, corners, _ = exported(cube, tmp_path / "a.obj")
    assert vertices.min(axis=0) == pytest.approx((9.0, -2.0, -3.0))
    assert volume(vertices, corners) == pytest.approx(8.0 * 6.0)


def test_a_mirrored_object_still_looks_outwards(tmp_path):
    cube = add_cube()
    cube.matrix_world = Matrix.Diagonal((-1.0, 1.0, 1.0, 1.0))
    vertices, _, corners, _ = exported(cube, tmp_path / "a.obj")
    assert volume(vertices, corners) == pytest.approx(8.0)


def test_a_large_offset_survives(tmp_path):
    cube = add_cube()
    cube.scale = (0.01, 0.01, 0.01)
    cube.location = (1e7, -1e7, 0.0)
    bpy.context.view_layer.update()
    vertices, _, corners, _ = exported(cube, tmp_path / "a.obj")
    assert area(vertices, corners) == pytest.approx(24e-4, rel=1e-6)


def test_the_render_uv_map_is_written(tmp_path):
    cube = add_cube()
    second = cube.data.uv_layers.new(name="Second")
    second.uv.foreach_set("vector", np.full(2 * len(cube.data.loops), 0.25, np.float32))
    assert len(exported(cube, tmp_path / "a.obj")[1]) > 1
    second.active_render = True
    assert exported(cube, tmp_path / "b.obj")[1].tolist() == [[0.25, 0.25]]


def normals_of(path):
    """(F, 3, 3) as the file names them."""
    lines = path.read_text().splitlines()
    table = np.array([line.split()[1:] for line in lines if line.startswith("vn ")], float)
    corners = [[word.split("/") for word in line.split()[1:]] for line in lines if line.startswith("f ")]
    return table[np.array(corners)[..., 2].astype(int) - 1]


@pytest.mark.parametrize("flip", [1.0, -1.0])
def test_smooth_shading_is_written_and_turns_as_normals_do(tmp_path, flip):
    bpy.ops.mesh.primitive_uv_sphere_add(radius=1.0, segments=24, ring_count=12)
    sphere = bpy.context.active_object
    exported(sphere, tmp_path / "flat.obj")
    assert "vn " not in (tmp_path / "flat.obj").read_text(), "the backend makes smooth ones"
    bpy.ops.object.shade_smooth()
    sphere.matrix_world = Matrix.Diagonal((flip * 1.0, 2.0, 4.0, 1.0))
    vertices, _, corners, _ = exported(sphere, tmp_path / "smooth.obj")
    normals = normals_of(tmp_path / "smooth.obj")
    wanted = vertices[corners] / np.square((1.0, 2.0, 4.0))  # of an ellipsoid
    wanted /= np.linalg.norm(wanted, axis=2, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0, atol=1e-6)
    assert (normals * wanted).sum(axis=2).min() > 0.999


def test_uvs_belong_to_their_corners(tmp_path):
    bpy.ops.mesh.primitive_plane_add(size=2.0)
    vertices, uvs, corners, uv_corners = exported(bpy.context.active_object, tmp_path / "a.obj")
    assert uvs[uv_corners] == pytest.approx(vertices[corners][..., :2] / 2.0 + 0.5)


def test_edits_in_edit_mode_count(tmp_path):
    cube = add_cube()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(5.0, 0.0, 0.0))
    vertices = exported(cube, tmp_path / "a.obj")[0]
    bpy.ops.object.mode_set(mode="OBJECT")
    assert vertices[:, 0].mean() == pytest.approx(5.0)


def test_a_mesh_without_faces_is_refused(tmp_path):
    cube = add_cube()
    cube.data.clear_geometry()
    with pytest.raises(BadInput, match="no faces"):
        exported(cube, tmp_path / "a.obj")


def export_now(folder):
    scene = bpy.context.scene
    export.export_scene(scene, bpy.data.objects["Cube"], bpy.context.evaluated_depsgraph_get(), folder)
    return scene_folder.read_scene(folder)


def test_photos_are_linked_not_copied(tmp_path):
    build(tmp_path / "photos")
    read = export_now(tmp_path / "scene")
    assert len(read.frames) == 4
    assert os.path.samefile(read.frames[0].image, tmp_path / "photos" / "photo 0.png")


def test_photos_are_copied_where_links_fail(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError("no hard links here")

    monkeypatch.setattr(os, "link", refuse)
    build(tmp_path / "photos")
    read = export_now(tmp_path / "scene")
    original = tmp_path / "photos" / "photo 0.png"
    assert not os.path.samefile(read.frames[0].image, original)
    assert read.frames[0].image.read_bytes() == original.read_bytes()


def test_exporting_again_keeps_the_originals(tmp_path):
    build(tmp_path / "photos")
    for _ in range(2):
        export_now(tmp_path / "scene")
    assert len(list((tmp_path / "photos").iterdir())) == 4


def test_a_folder_of_the_users_is_never_emptied(tmp_path):
    build(tmp_path / "photos")
    (tmp_path / "transforms.json").write_text("mine")
    with pytest.raises(BadInput, match="other files"):
        export_now(tmp_path)
    assert (tmp_path / "transforms.json").read_text() == "mine"


def test_same_names_do_not_collide(tmp_path):
    add_cube()
    for index, folder in enumerate(("left", "right", "RIGHT")):
        save_picture(tmp_path / folder / "0001.png", 8 + index, 8)
        add_camera(folder, (5.0, index, 0.0), photo=tmp_path / folder / "0001.png")
    read = export_now(tmp_path / "scene")
    assert sorted(frame.camera.width for frame in read.frames) == [8, 9, 10]
    assert len({str(frame.image).lower() for frame in read.frames}) == 3
    assert all(photos.header_size(frame.image)[0] == frame.camera.width for frame in read.frames)
    assert {frame.image.name for frame in read.frames} == {"0001.png"}, "priors are found by name"


def test_one_photo_behind_two_cameras_is_written_once(tmp_path):
    add_cube()
    save_picture(tmp_path / "a.png", 8, 8)
    for index in range(2):
        add_camera(str(index), (5.0, index, 0.0), photo=tmp_path / "a.png")
    read = export_now(tmp_path / "scene")
    assert read.frames[0].image == read.frames[1].image


def test_packed_generated_and_painted_images_are_saved_out(tmp_path):
    add_cube()
    save_picture(tmp_path / "packed.png", 8, 8)
    packed = bpy.data.images.load(str(tmp_path / "packed.png"))
    packed.pack()
    before = (tmp_path / "packed.png").read_bytes()
    (tmp_path / "packed.png").unlink()
    generated = bpy.data.images.new("generated", 12, 8)
    generated.generated_type = "COLOR_GRID"
    painted = bpy.data.images.new("painted", 20, 2, alpha=True)
    stripes = np.zeros((2, 20, 4), np.float32)
    stripes[0], stripes[1] = (1.0, 0.0, 0.0, 1.0), (0.0, 0.2, 0.4, 0.6)
    painted.pixels.foreach_set(stripes.ravel())
    floating = bpy.data.images.new("floating", 16, 8, float_buffer=True)
    floating.pixels.foreach_set(np.tile(np.float32((3.5, 0.25, 0.0, 1.0)), 16 * 8))
    for index, image in enumerate((packed, generated, painted, floating)):
        set_photo(add_camera(image.name, (5.0, index, 0.0)), image)
    by_width = {frame.camera.width: frame.image for frame in export_now(tmp_path / "scene").frames}
    assert by_width[8].read_bytes() == before, "packed bytes are not encoded again"
    assert photos.header_size(by_width[12]) == (12, 8)
    back = bpy.data.images.load(str(by_width[16]))
    assert by_width[16].suffix == ".exr" and back.pixels[:4] == pytest.approx((3.5, 0.25, 0.0, 1.0))
    again = bpy.data.images.load(str(by_width[20]))
    assert np.array(again.pixels) == pytest.approx(stripes.ravel())
    assert generated.source == "GENERATED", "the user's image stays as it was"


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_sizes_come_from_headers(tmp_path, suffix):
    image = bpy.data.images.new("picture", 37, 21)
    image.filepath_raw = str(tmp_path / f"a{suffix}")
    image.file_format = "JPEG" if suffix == ".jpg" else "PNG"
    image.save()
    assert photos.header_size(tmp_path / f"a{suffix}") == (37, 21)
    (tmp_path / "cut").write_bytes((tmp_path / f"a{suffix}").read_bytes()[:20])
    assert photos.header_size(tmp_path / "cut") is None


def test_problems_are_named(tmp_path):
    build(tmp_path / "photos")
    (tmp_path / "photos" / "photo 1.png").unlink()
    bpy.data.objects["Camera 2"].data.type = "ORTHO"
    said = [photos.problem(photo) for photo in photos.photos_in(bpy.context.scene)]
    assert [bool(text) for text in said] == [False, True, True, False]
    assert "missing" in said[1] and "perspective" in said[2]
    with pytest.raises(BadInput):
        export_now(tmp_path / "scene")


def test_a_hidden_photo_is_left_out(tmp_path):
    build(tmp_path / "photos")
    bpy.data.cameras["Camera 1"].background_images[0].show_background_image = False
    assert len(export_now(tmp_path / "scene").frames) == 3


def test_new_uvs_come_back(tmp_path):
    cube = add_cube()
    vertices, uvs, corners, uv_corners = exported(cube, tmp_path / "a.obj")
    changed = Triangles(vertices, corners, uvs * 0.5, uv_corners)
    write_obj(tmp_path / "b.obj", changed)
    assert uv_back.bring_back(cube, tmp_path / "b.obj") == cube
    assert cube.data.uv_layers[uv_back.UV_MAP].active_render
    assert exported(cube, tmp_path / "c.obj")[1].max() == pytest.approx(uvs.max() * 0.5)


def test_new_uvs_that_do_not_fit_make_a_new_object(tmp_path):
    cube = add_cube()
    cube.modifiers.new("Bigger", "SUBSURF").levels = 1
    exported(cube, tmp_path / "a.obj")
    made = uv_back.bring_back(cube, tmp_path / "a.obj")
    assert made != cube and len(made.data.polygons) == 48
    assert uv_back.UV_MAP not in cube.data.uv_layers
