"""Stand-in priors of a small roof-shaped scene, photographed by three cameras from above."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from dante_w.contract.scene_folder import read_scene
from measure.metrics import psnr
from measure.pictures import read, write
from measure.views import Surface, Viewer, linear_texture
from methods.stand_in_prior import SHARED_LIGHT, BakedLight, Strength, View, blur, make_priors, observe, spoil
from stand_in_prior import Figures, nearer, off

SIDE = 64  # pixels of a photo
ROOF = """v -1 -1 0\nv 0 -1 0.5\nv 0 1 0.5\nv -1 1 0\nv 1 -1 0\nv 1 1 0
vt 0 0\nvt 0.5 0\nvt 0.5 1\nvt 0 1\nvt 1 0\nvt 1 1
f 1/1 2/2 3/3 4/4\nf 2/2 5/5 6/6 3/3\n"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return build(tmp_path / "roof")


def build(
    folder: Path,
    texture: np.ndarray | None = None,
    names: tuple[str, ...] = ("a", "b", "c"),
    left: float = 0.4,
    right: float = 0.4,
) -> Path:
    """Write a scene folder. View b is view a, the camera rolled by 90 degrees; photos show the two slopes of the
    roof, the left and right half of the texture, in light of these strengths. Some pixels are not quite opaque."""
    if texture is None:
        texture = np.random.default_rng(5).uniform(0.3, 0.8, (8, 8, 3)).repeat(16, 0).repeat(16, 1)
    folder.mkdir()
    (folder / "mesh.obj").write_text(ROOF)
    write(folder / "albedo_gt.png", texture)
    roll = {"a": 0.0, "b": np.pi / 2, "c": 0.3}
    for role, prefix in (("train", ""), ("test", "albedo_")):
        frames = [
            {"file_path": f"{role}/{prefix}{name}.png", "transform_matrix": above(roll[name])}
            for name in names
        ]
        if role == "test":
            frames[0]["relit"] = {"sky": "train/a.png"}
        content = {"camera_angle_x": 0.8, "w": SIDE, "h": SIDE, "frames": frames}
        (folder / f"transforms_{role}.json").write_text(json.dumps(content))
        viewer = Viewer(folder / "mesh.obj", read_scene(folder / f"transforms_{role}.json").frames)
        shown = linear_texture(folder / "albedo_gt.png")
        if role == "train":
            shown = shown * np.repeat([left, right], shown.shape[1] // 2)[:, None]
        for index, frame in enumerate(viewer.frames):
            picture, alpha = viewer.view(shown, index)[0], np.ones((SIDE, SIDE, 1))
            alpha[: SIDE // 2] = 0.96
            alpha *= viewer.view(shown, index)[1][..., None]
            write(frame.image, np.dstack([picture * alpha, alpha]))
    return folder


def above(roll: float) -> list[list[float]]:
    """The pose of a camera that looks down on the middle of the roof, turned about its axis."""
    c, s = np.cos(roll), np.sin(roll)
    return [[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]


def files(out: Path) -> dict[str, bytes]:
    return {str(file.relative_to(out)): file.read_bytes() for file in sorted(out.rglob("*.*"))}


def on_picture(view: View, values: np.ndarray) -> np.ndarray:
    """Values (N, 3) at the pixels inside as (H, W, 3), NaN elsewhere."""
    picture = np.full(view.truth.shape, np.nan)
    picture[view.inside] = values
    return picture


def raw_psnr(scene: Path, out: Path) -> float:
    truth, alpha = read(scene / "test" / "albedo_a.png")
    return psnr(read(out / "test" / "albedo_a.png")[0], truth, alpha > 0.999)


def test_the_same_scene_and_strength_give_the_same_bytes_in_any_order_of_views(scene: Path, tmp_path: Path):
    strength = Strength(1.0, 1.0)
    make_priors(scene, strength, tmp_path / "first")
    (tmp_path / "again").mkdir()
    again = build(tmp_path / "again" / scene.name, names=("b", "a", "c"))
    # the relit photo belongs to a view, whichever comes first
    (again / "transforms_test.json").write_text((scene / "transforms_test.json").read_text())
    make_priors(again, strength, tmp_path / "second")
    first = files(tmp_path / "first")
    assert sorted(first) == [f"test/albedo_{name}.png" for name in "abc"] + [
        f"train/{name}.png" for name in "abc"
    ]
    assert first == files(tmp_path / "second")


def test_no_strength_gives_the_true_albedo(scene: Path, tmp_path: Path):
    make_priors(scene, Strength(0.0, 0.0), tmp_path / "out")
    for truth_file in sorted((scene / "test").iterdir()):
        truth, alpha = read(truth_file)
        prior, own_alpha = read(tmp_path / "out" / "test" / truth_file.name)
        assert np.array_equal(alpha, own_alpha)
        assert np.abs(prior - truth)[alpha > 0.9].max() < 2.5 / 255.0


def test_shared_error_belongs_to_the_surface_and_own_error_to_the_view(scene: Path):
    views = {view.file: view for view in observe(scene)}
    one, rolled = views["train/a.png"], views["train/b.png"]
    turned = np.rot90(on_picture(rolled, rolled.shared), 1)  # pixel centres fall on pixel centres
    shared = on_picture(one, one.shared)
    both = np.isfinite(turned) & np.isfinite(shared)
    assert both.sum() > 0.98 * np.isfinite(shared).sum() > 1000
    assert shared[both].std() > 0.1
    # the light is baked in cells; a point on the border of two may fall into either
    assert np.median(np.abs(turned - shared)[both]) < 1e-4
    on_object = np.rot90(on_picture(rolled, rolled.own), 1) - on_picture(one, one.own)
    in_picture = on_picture(rolled, rolled.own) - on_picture(one, one.own)
    assert np.nanstd(on_object) > 0.1
    assert np.nanstd(in_picture) > 0.1


def test_light_that_the_photos_share_leaks_into_every_prior(tmp_path: Path):
    texture = np.ones((16, 16, 3))
    lit = {"even": (0.4, 0.4), "right": (0.2, 0.8)}
    leak = {}
    for name, (left, right) in lit.items():
        # one folder name, so that nothing but the light differs
        folder = tmp_path / name
        folder.mkdir()
        view = observe(build(folder / "roof", texture, left=left, right=right))[0]
        error = on_picture(view, view.shared)
        leak[name] = np.nanmean(error[:, SIDE // 2 + 4 :]) - np.nanmean(error[:, : SIDE // 2 - 4])
    assert leak["right"] - leak["even"] == pytest.approx(SHARED_LIGHT * np.log(4.0), rel=0.15)


def test_the_two_sides_of_a_board_keep_their_own_light():
    middle, up = np.full((5, 3), 0.5), np.tile([0.0, 0.0, 1.0], (5, 1))
    light = BakedLight()
    above_it, below = Surface(np.arange(5), middle, up), Surface(np.arange(5), middle, -up)
    light.add(above_it, np.full((5, 3), 0.7))
    light.add(below, np.full((5, 3), -0.2))
    assert np.allclose(light(above_it), 0.7)
    assert np.allclose(light(below), -0.2)


@pytest.mark.parametrize(("small", "large"), [((0.3, 0), (0.9, 0)), ((0, 0.3), (0, 0.9))])
def test_a_larger_factor_is_further_from_the_truth(scene: Path, tmp_path: Path, small, large):
    make_priors(scene, Strength(*small), tmp_path / "small")
    make_priors(scene, Strength(*large), tmp_path / "large")
    assert raw_psnr(scene, tmp_path / "small") > raw_psnr(scene, tmp_path / "large") + 3.0


def test_black_albedo_and_black_photos_stay_finite(tmp_path: Path):
    black = build(tmp_path / "black", np.zeros((16, 16, 3)))
    for view in observe(black):
        picture = spoil(view, Strength(2.0, 2.0))
        assert np.isfinite(picture).all()
        assert picture.max() == 0.0


def test_background_does_not_bleed_in(tmp_path: Path):
    flat = build(tmp_path / "flat", np.full((16, 16, 3), 0.5))
    view = observe(flat)[0]
    assert 0.2 < view.inside.mean() < 0.8
    blur_alone = view._replace(shared=0.0 * view.shared, own=0.0 * view.own, blur=1.0)
    for shared, own in ((0.0, 3.0), (3.0, 0.0)):
        assert np.abs(spoil(blur_alone, Strength(shared, own)) - 0.5).max() < 1.5 / 255.0


def test_blur_counts_only_what_is_inside():
    picture = np.zeros((9, 9, 3))
    picture[:, 5:] = 1.0
    inside = np.zeros((9, 9), bool)
    inside[:, 5:] = True
    assert np.allclose(blur(picture, inside, 3.0), picture)
    assert blur(picture, np.ones((9, 9), bool), 3.0)[4, 4].mean() > 0.2


def test_a_calibration_step_lowers_what_is_too_good():
    paper = Figures(raw=21.65, lifted=25.32)
    strength = Strength(1.0, 1.0)
    assert nearer(strength, paper, paper) == strength
    assert off(Figures(21.0, 25.4), paper) == pytest.approx(0.65)
    assert nearer(strength, Figures(21.65, 27.0), paper).shared > 1.0
    assert nearer(strength, Figures(20.0, 25.32), paper).own < 1.0
