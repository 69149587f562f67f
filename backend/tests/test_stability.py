"""What is promised at the extremes, as far as it is fast; `python3 dev.py bench stability` has the rest."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import torch
from conftest import cast
from dante_w.commands.cli import main
from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import read_scene
from dante_w.core.color import linear_from_srgb, srgb_from_linear
from dante_w.field.cpu.kernels.functions import srgb_from_linear as kernel_srgb
from dante_w.field.cpu.step import CpuStep
from dante_w.field.divergence import FitResult
from dante_w.field.fields import FieldModel, FieldSpec
from dante_w.field.hash_encoding import GridSpec, HashGrid, encode_reference
from dante_w.field.loss import model_loss
from dante_w.field.optimise import Problem, Schedule, fit
from dante_w.field.settings import FieldSettings
from dante_w.field.step import TorchStep
from dante_w.field.terms import LossTerms
from dante_w.presets import Preset
from dante_w.rays.radiance_levels import RADIANCE, into_range
from dante_w.rays.ray_cache import Samples
from dante_w.rays.raycast import Frame3D, Raycaster
from dante_w.run.setbacks import MOST
from dante_w.scene.images import read_photo, read_texture, write_exr
from dante_w.scene.mesh import Mesh
from dante_w.traced.shading_points import ShadingPoints, gather
from small_settings import TRACED
from square_scene import CAMERA, albedo_at, make_scene

SPEC = FieldSpec(GridSpec(2, 4, 2, 4, 32, 10), GridSpec(3, 2, 2, 2, 4, 8), hidden=16, embedding=2)
FIELD = FieldSettings(SPEC, Schedule(100, 1024, 1e-2), Schedule(20, 1024, 2e-3))
SMALL = Preset("standard", 64, TRACED, FIELD)


def with_rate(rate: float) -> Preset:
    """Small settings whose main pass has another learning rate."""
    schedule = dataclasses.replace(FIELD.schedule, learning_rate=rate)
    return dataclasses.replace(SMALL, field=dataclasses.replace(FIELD, schedule=schedule))


def square() -> Mesh:
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float64)
    faces = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
    return Mesh(corners, faces, corners[faces][..., :2].copy())


def samples(count: int = 256, weight: float | None = None) -> Samples:
    random = torch.Generator().manual_seed(1)
    return Samples(
        torch.randint(0, 3, (count,), generator=random),
        torch.rand(count, 2, generator=random),
        torch.rand(count, 3, generator=random),
        torch.rand(count, 3, generator=random),
        None,
        None if weight is None else torch.full((count,), weight),
    )


class Cache:
    """Samples in place of a ray cache."""

    def __init__(self, colour: float | None = None) -> None:
        self.all = samples(4096)
        if colour is not None:
            self.all = dataclasses.replace(self.all, colour=torch.full((4096, 3), colour))

    def samples(self, index: np.ndarray, device: torch.device) -> Samples:
        fields = (getattr(self.all, field.name) for field in dataclasses.fields(Samples))
        return Samples(*(None if column is None else column[index] for column in fields))


def fitted(rate: float, steps: int = 200) -> tuple[FieldModel, FitResult]:
    torch.manual_seed(0)
    model = FieldModel(SPEC, 3)
    cache = Cache()
    problem = Problem(model, cache, np.array([[0, 4096]]), LossTerms())
    result = fit(problem, Schedule(steps, 512, rate), 0, lambda *_: None)
    return model, result


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_transfer_and_its_inverse_rise_everywhere(dtype):
    size = 2.0 ** torch.linspace(-100.0, 50.0, 5001, dtype=torch.float64)
    joints = torch.tensor(
        [0.0031306, 0.00313067, 0.0031308, 0.0031308001, 0.040448, 0.04045, 0.0, 1.0], dtype=torch.float64
    )
    values = torch.cat([-size, joints, size]).to(dtype).unique()
    for curve in (srgb_from_linear, linear_from_srgb):
        at = values.clone().requires_grad_()
        out = curve(at)
        (slope,) = torch.autograd.grad(out.sum(), at)
        assert torch.isfinite(out).all() and torch.isfinite(slope).all() and (slope > 0.0).all()
        falls = (out[:-1] - out[1:]).clamp_min(0.0) / out[:-1].abs().clamp_min(1e-30)
        assert falls.max() <= (1e-15 if dtype == torch.float64 else 2e-6)


def test_the_kernels_transfer_has_no_step_where_its_pieces_meet():
    around = np.linspace(0.00313, 0.003132, 200).astype(np.float32)
    values = np.array([kernel_srgb(value)[0] for value in around], np.float64)
    assert np.diff(values).min() > -1e-8


@pytest.mark.parametrize("kind", [TorchStep, CpuStep])
def test_a_batch_that_weighs_nothing_has_a_loss_and_moves_nothing(kind):
    model = FieldModel(SPEC, 3)
    before = [parameter.detach().clone() for parameter in model.parameters()]
    terms = LossTerms(white_light=0.05, small_offset=0.2)
    assert float(model_loss(model, samples(weight=0.0), terms).detach()) == 0.0
    step = kind(model, terms, list(model.parameters()), 1e-2)
    loss, gradients = step.gradients(samples(weight=0.0))
    assert float(loss) == 0.0 and all(not torch.as_tensor(g).any() for g in gradients.values())
    step.update(1.0)
    assert all(torch.equal(a, b) for a, b in zip(before, model.parameters(), strict=True))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_tables_in_halves_lose_values_but_not_places(dtype):
    torch.manual_seed(0)
    grid = HashGrid(GridSpec(2, 3, 2, 15, 4000, 12))
    torch.nn.init.uniform_(grid.tables, -1.0, 1.0)
    points = torch.rand(500, 2)
    exact = encode_reference(points.double(), grid.tables.detach().double(), grid.spec)
    found = encode_reference(points, grid.tables.detach().to(dtype), grid.spec).double()
    assert float((found - exact).abs().max()) < 8.0 * torch.finfo(dtype).eps + 0.002


def test_a_sound_fit_is_left_alone():
    _, result = fitted(1e-2)
    assert result.setbacks == [] and result.last_loss < 0.9 * result.first_loss


@pytest.mark.parametrize("rate", [30.0, 1e6])
def test_a_fit_that_diverges_is_taken_back_and_ends_as_well(rate):
    model, result = fitted(rate)
    assert result.setbacks and result.setbacks[-1].rate < 1.0
    assert result.last_loss < 1.1 * fitted(1e-2)[1].last_loss
    assert all(torch.isfinite(parameter).all() for parameter in model.parameters())


def test_a_fit_that_cannot_be_saved_ends_where_it_began():
    model, result = fitted(float("inf"))
    torch.manual_seed(0)
    assert len(result.setbacks) == MOST
    fresh = FieldModel(SPEC, 3)
    assert all(torch.equal(a, b) for a, b in zip(model.parameters(), fresh.parameters(), strict=True))


def test_a_fit_that_explains_nothing_is_no_success(scene, tmp_path, capsys):
    command = ["recover", str(scene), "--out", str(tmp_path / "out"), "--irradiance", "field", "--json"]
    code = main(command, settings=with_rate(0.0))
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 1 and "explained nothing" in last["message"] and "\n" not in last["message"]
    assert not (tmp_path / "out").exists()


def test_setbacks_are_in_the_report(scene, tmp_path, capsys):
    command = ["recover", str(scene), "--out", str(tmp_path / "out"), "--irradiance", "field", "--json"]
    assert main(command, settings=with_rate(1e4)) == 0
    setbacks = json.loads((tmp_path / "out/report.json").read_text())["setbacks"]
    assert list(setbacks) == ["optimise", "held-out", "final pass"]
    assert set(setbacks["optimise"][0]) == {"step", "reason", "rate"}


@pytest.mark.parametrize("scale", [1e-30, 1e-8, 1.0, 1e8, 1e20])
def test_float_photos_of_any_radiance_are_brought_into_range(scale):
    linear = np.random.default_rng(0).uniform(0.01, 0.8, (5000, 3))
    encoded = srgb_from_linear(torch.from_numpy(linear * scale).float()).numpy()
    found, level = into_range(encoded)
    wanted, own = into_range(srgb_from_linear(torch.from_numpy(linear).float()).numpy())
    np.testing.assert_allclose(found, wanted, atol=2e-5)
    assert level == pytest.approx(own - np.log(scale), abs=1e-4)
    bright = np.quantile(linear_from_srgb(torch.from_numpy(found)).numpy().max(axis=1), 0.99)
    assert bright == pytest.approx(RADIANCE.nearly_white, rel=1e-3)


def test_glints_neither_set_the_level_nor_keep_their_brightness():
    encoded = np.full((1000, 3), 0.5, np.float32)
    encoded[:5] = 1e5
    found, _ = into_range(encoded)
    assert found[100] == pytest.approx(into_range(encoded[5:])[0][0], abs=1e-6)
    assert found.max() == pytest.approx(float(srgb_from_linear(torch.tensor(RADIANCE.brightest))), rel=1e-5)
    assert (
        into_range(np.zeros((4, 3), np.float32))[1] == 0.0
        and into_range(np.zeros((0, 3), np.float32))[1] == 0.0
    )


def test_integer_photos_keep_their_range(scene, tmp_path):
    frames = read_scene(scene).frames
    cache = cast(square(), frames[:2], tmp_path)
    assert cache.log_gain is not None and not cache.log_gain.any()
    photo = read_photo(frames[0].image)
    assert set(np.unique(cache.colour[: cache.starts[1]])) <= set(np.unique(photo.srgb.astype(np.float16)))


def test_unknown_pixels_of_a_prior_are_unknown_not_black(scene, tmp_path):
    prior = np.full((CAMERA.height, CAMERA.width, 3), 0.3, np.float32)
    prior[: CAMERA.height // 2] = np.nan
    write_exr(tmp_path / "prior.exr", prior)
    frame = dataclasses.replace(read_scene(scene).frames[0], albedo=tmp_path / "prior.exr")
    cache = cast(square(), [frame], tmp_path)
    assert cache.prior is not None
    known = np.isfinite(cache.prior).all(axis=1)
    assert 0.2 < known.mean() < 0.8 and (cache.prior[known] > 0.5).all()


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
@pytest.mark.parametrize("irradiance", ["traced", "field"])
def test_photos_that_show_nothing_are_bad_input(tmp_path, capsys, value, irradiance):
    folder = make_scene(tmp_path / "scene", photos=3)
    for index in range(3):
        write_exr(folder / f"{index}.exr", np.full((CAMERA.height, CAMERA.width, 3), value, np.float32))
    text = (folder / "transforms.json").read_text()
    (folder / "transforms.json").write_text(text.replace(".png", ".exr"))
    code = main(
        ["recover", str(folder), "--out", str(tmp_path / "out"), "--irradiance", irradiance, "--json"],
        settings=SMALL,
    )
    message = json.loads(capsys.readouterr().out.splitlines()[-1])["message"]
    assert code == 2 and ("black or overexposed" if value == 0.0 else "not finite") in message


@pytest.mark.parametrize("photos", [1, 2])
def test_one_photo_or_two_give_a_texture_by_traced_light(tmp_path, capsys, photos):
    folder = make_scene(tmp_path / "scene", photos=photos)
    assert main(["recover", str(folder), "--out", str(tmp_path / "out"), "--json"], settings=SMALL) == 0
    capsys.readouterr()
    found = read_texture(tmp_path / "out/albedo.png")
    centres = (np.arange(64) + 0.5) / 64
    truth = albedo_at(np.stack(np.meshgrid(centres, 1.0 - centres), axis=-1))
    middle = np.s_[16:48, 16:48]
    assert np.corrcoef(found[middle].ravel(), truth[middle].ravel())[0, 1] > 0.9


def test_rays_from_afar_meet_what_they_aim_at():
    caster = Raycaster(square(), Frame3D.bounding(square().vertices))
    target = np.random.default_rng(0).uniform(0.05, 0.95, (200, 2))
    for away in (1.0, 1e3, 1e6):
        origin = 0.5 + away * np.array([0.6, -0.45, 1.0])
        aim = np.column_stack([target, np.full(200, 0.5)]) - origin
        hits = caster.cast(origin, 3.0 * aim)
        weights = np.column_stack([1.0 - hits.bary.sum(axis=1), hits.bary])
        at = np.einsum("nc,ncd->nd", weights, square().vertices[square().faces[hits.face]])[:, :2]
        np.testing.assert_allclose(at, target[hits.ray], atol=2e-6)
        assert len(hits.ray) == 200
        np.testing.assert_allclose(hits.distance, 1.0 / 3.0, rtol=1e-5)


def test_vertices_of_no_triangle_do_not_count():
    mesh = square()
    stray = dataclasses.replace(mesh, vertices=np.vstack([mesh.vertices, [[1e9, 0.0, -1e9]]]))
    assert Frame3D.around(stray).extent == 1.0


def test_a_camera_on_the_surface_still_has_footprints(scene, tmp_path):
    frame = read_scene(scene).frames[0]
    pose = frame.camera_to_world.copy()
    pose[:3, 3] = 0.5, 0.5, 0.0
    frames = [frame, dataclasses.replace(frame, camera_to_world=pose)]
    cache = cast(square(), frames, tmp_path)
    assert cache.finest is not None and cache.finest.min() > 0.0
    points = ShadingPoints(
        np.zeros(1, np.int32), np.array([[0.5, 0.5, 0.0]], np.float32), np.eye(3, dtype=np.float32)[2:]
    )
    assert np.isfinite(points.towards(np.zeros(1, int), np.array([0.5, 0.5, 0.0]))).all()


def test_faces_without_a_place_on_the_texture_tell_nothing(scene, tmp_path):
    mesh = square()
    assert mesh.uvs is not None
    uvs = mesh.uvs.copy()
    uvs[1] = 0.5
    cache = cast(
        dataclasses.replace(mesh, uvs=uvs),
        read_scene(scene).frames,
        tmp_path,
    )
    assert set(np.unique(cache.face)) == {0}


def test_a_photo_of_the_other_side_of_a_sheet_is_left_out(scene, tmp_path):
    frames = read_scene(scene).frames
    below = np.diag([1.0, -1.0, -1.0, 1.0])
    below[:3, 3] = 0.5, 0.5, -1.2
    frames = [dataclasses.replace(frames[0], camera_to_world=below), *frames]
    cache = cast(square(), frames, tmp_path)
    frame3d = Frame3D.bounding(square().vertices)
    cameras = frame3d.normalise(np.stack([frame.camera_to_world[:3, 3] for frame in frames]))
    points, seen = gather(cache, cameras)
    many = np.bincount(seen.point, minlength=len(points)) > 2
    assert many.any() and (points.normal[many, 2] > 0.9).all()
    assert not (many[seen.point] & (seen.photo == 0)).any()


def test_a_mesh_without_a_photo_of_it_is_told_apart_from_masked_photos(scene, tmp_path):
    far = dataclasses.replace(square(), vertices=square().vertices + 50.0)
    with pytest.raises(BadInput, match="coordinate system"):
        cast(far, read_scene(scene).frames, tmp_path)
