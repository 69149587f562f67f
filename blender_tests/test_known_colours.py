"""Spots of known colour: picked on the mesh, kept on the object, told to the backend."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector
from small_scene import add_cube
from test_headless import run
from test_run import finish
from test_surface import add_plane, depsgraph

from dante_w_addon.blender import known_colours, material, surface, survey
from dante_w_addon.operators.known_colour import DANTEW_OT_pick_known_colour as Pick


def test_spots_are_added_and_removed(addon):
    plane = add_plane()
    pick, spots = bpy.ops.dantew.pick_known_colour, known_colours.spots_of(plane)
    assert pick(location=(0.4, -0.2, 0.0)) == {"FINISHED"}
    assert pick(location=(0.0, 0.0, 0.0), grey=False, colour=(0.2, 0.4, 1.0)) == {"FINISHED"}
    assert known_colours.as_words(plane) == (
        ("0.700000", "0.400000", "grey"),
        ("0.500000", "0.500000", "#3366FF"),
    )
    assert [spot.uv_map for spot in spots] == ["UVMap", "UVMap"]
    assert tuple(spots[0].location) == pytest.approx((0.4, -0.2, 0.0))
    with pytest.raises(RuntimeError, match="only 2"):
        bpy.ops.dantew.remove_known_colour(index=2)
    bpy.ops.dantew.remove_known_colour(index=0)
    assert [words[2] for words in known_colours.as_words(plane)] == ["#3366FF"]
    bpy.ops.dantew.remove_known_colour(index=0)
    assert not bpy.ops.dantew.remove_known_colour.poll()


def test_a_given_face_is_taken(addon):
    """Where a ray meets one of two faces that touch, the nearest may be the other."""
    cube = add_cube()
    top = max(cube.data.polygons, key=lambda polygon: polygon.center.z).index
    edge, expected = Vector((-1.0, 0.0, 1.0)), []  # a seam
    for face in (top, next(p.index for p in cube.data.polygons if p.center.x < -0.5)):
        bpy.ops.dantew.pick_known_colour(location=edge, face=face)
        expected.append(surface.uv_at(cube, depsgraph(), edge, face)[:2])
    found = [(spot.u, spot.v) for spot in known_colours.spots_of(cube)]
    assert np.array(found) == pytest.approx(np.array(expected)) and len(set(expected)) == 2


def test_picking_says_what_it_needs(addon):
    poll = bpy.ops.dantew.pick_known_colour.poll
    assert not poll()
    plane = add_plane()
    assert poll()
    plane.hide_viewport = True
    assert not poll(), "there is nothing to click"
    plane.hide_viewport = False
    bpy.context.scene.dante_w.unwrap = True
    assert not poll(), "new UVs would not have the spot"
    bpy.context.scene.dante_w.unwrap = False
    bpy.ops.object.mode_set(mode="EDIT")
    assert not poll()


def from_above(regions):
    """A context with 3D views that look down on x and y from -2 to 2 in 200 x 200 pixels."""
    eye = Matrix.Translation((0.0, 0.0, -10.0))
    view = SimpleNamespace(
        is_perspective=False,
        view_perspective="ORTHO",
        view_matrix=eye,
        perspective_matrix=Matrix.Diagonal((0.5, 0.5, -0.01, 1.0)) @ eye,
    )
    for region in regions:
        region.data = view
    area = SimpleNamespace(type="VIEW_3D", regions=regions)
    calls = []
    return SimpleNamespace(
        screen=SimpleNamespace(areas=[SimpleNamespace(type="OUTLINER", regions=regions), area]),
        view_layer=bpy.context.view_layer,
        evaluated_depsgraph_get=depsgraph,
        window=SimpleNamespace(cursor_modal_restore=lambda: calls.append("cursor")),
        workspace=SimpleNamespace(status_text_set=lambda text: calls.append(text)),
        calls=calls,
    )


def region(kind, x, y, width=200, height=200):
    return SimpleNamespace(type=kind, x=x, y=y, width=width, height=height)


def click(context, event):
    """What the modal operator answers to an event, and itself after that."""
    said = []
    operator = SimpleNamespace(
        report=lambda kind, text: said.append(text), execute=lambda context: {"FINISHED"}, said=said
    )
    operator.cancel = lambda context: Pick.cancel(operator, context)
    operator._hit = lambda context, mouse: Pick._hit(operator, context, mouse)
    return Pick.modal(operator, context, event), operator


def event(kind, x=0, y=0, value="PRESS"):
    return SimpleNamespace(type=kind, value=value, mouse_x=x, mouse_y=y)


def test_a_click_meets_the_mesh_under_it():
    add_plane().matrix_world = Matrix.Translation((0.5, 0.0, 0.0))
    bpy.context.view_layer.update()
    context = from_above([region("WINDOW", 100, 50), region("UI", 290, 50, 10)])
    answer, operator = click(context, event("LEFTMOUSE", 100 + 160, 50 + 80))
    assert answer == {"FINISHED"} and context.calls == ["cursor", None]
    point, face = operator.location, operator.face
    assert (tuple(point), face) == (pytest.approx((0.7, -0.4, 0.0), abs=1e-5), 0)


@pytest.mark.parametrize("at", [(110, 60), (299, 150), (500, 500)], ids=["beside", "sidebar", "elsewhere"])
def test_a_click_that_misses_is_said_and_may_be_repeated(at):
    plane = add_plane()
    plane.matrix_world = Matrix.Translation((1.0, 0.0, 0.0))  # under the sidebar too
    bpy.context.view_layer.update()
    context = from_above([region("WINDOW", 100, 50), region("UI", 290, 50, 10)])
    answer, operator = click(context, event("LEFTMOUSE", *at))
    assert answer == {"RUNNING_MODAL"} and "missed" in operator.said[0] and not context.calls


def test_picking_can_be_left_and_the_view_turned_meanwhile():
    context = from_above([region("WINDOW", 0, 0)])
    for kind in ("ESC", "RIGHTMOUSE"):
        assert click(context, event(kind))[0] == {"CANCELLED"}
        assert context.calls[-2:] == ["cursor", None]
    assert click(context, event("MIDDLEMOUSE"))[0] == {"PASS_THROUGH"}
    assert click(context, event("X"))[0] == {"RUNNING_MODAL"}, "deleting must wait"
    assert click(context, event("LEFTMOUSE", value="RELEASE"))[0] == {"RUNNING_MODAL"}


def pick_two():
    bpy.ops.dantew.pick_known_colour(location=(0.0, 0.0, 1.0))
    bpy.ops.dantew.pick_known_colour(location=(1.0, 0.0, 0.0), grey=False, colour=(1.0, 0.5, 0.25))


def known_in(arguments):
    """The words after each `--known`."""
    return [arguments[i + 1 : i + 4] for i, word in enumerate(arguments) if word == "--known"]


def test_spots_reach_the_backend(addon, standin, scene):
    bpy.ops.dantew.recover()
    finish()
    cube = bpy.data.objects["Cube"]
    assert known_in(material.report_of(cube)["arguments"]) == []
    pick_two()
    bpy.ops.dantew.recover()
    finish()
    known = known_in(material.report_of(cube)["arguments"])
    assert known == [["0.750000", "0.625000", "grey"], ["0.500000", "0.625000", "#FF8040"]]


def test_spots_that_do_not_fit_stand_in_the_way(addon, standin, scene):
    cube = bpy.data.objects["Cube"]

    def problems():
        survey._cache = None
        return survey.examine(scene, cube).problems

    pick_two()
    assert problems() == ()
    scene.dante_w.unwrap = True
    assert "do not fit new UVs" in problems()[0]
    assert not bpy.ops.dantew.recover.poll()
    scene.dante_w.unwrap = False
    cube.data.uv_layers.new(name="Second").active_render = True
    assert "picked on the UV map UVMap" in problems()[0]
    known_colours.spots_of(cube).clear()
    assert problems() == ()


def test_without_a_window(addon, scene, tmp_path):
    """Spots saved with the file count, those of the command line take their place."""
    cube, blend = bpy.data.objects["Cube"], bpy.data.filepath
    pick_two()
    saved = [list(words) for words in known_colours.as_words(cube)]
    bpy.ops.wm.save_mainfile()

    def told(*more):
        done = run(blend, tmp_path / "out", *more)
        assert done.returncode == 0, done.stderr
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "small scene.blend"))
        return known_in(material.report_of(bpy.data.objects["Cube"])["arguments"])

    assert told() == saved
    mine = ["0.5", "1e-3", "#7a7a79"]
    assert told("--known", *mine, "--known", "0.1", "0.2", "grey") == [mine, ["0.1", "0.2", "grey"]]


@pytest.mark.parametrize("more", [(), ("--known", "0.5", "0.5", "grey")], ids=["saved", "command line"])
def test_without_a_window_new_uvs_are_refused(addon, scene, tmp_path, more):
    if not more:
        pick_two()
        bpy.ops.wm.save_mainfile()
    done = run(bpy.data.filepath, tmp_path / "out", "--unwrap", *more)
    assert done.returncode == 2 and "UV" in done.stderr, done.stderr
    assert not (tmp_path / "out").exists()
