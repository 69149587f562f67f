import numpy as np
import torch
from conftest import cast
from dante_w.core.color import linear_from_srgb
from dante_w.field.fields import FieldModel, FieldSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.optimise import photo_ranges
from dante_w.field.scale_ambiguity import ScaleSettings, albedo_gain, start_exposures
from dante_w.scene.load import load_scene

SPEC = FieldSpec(GridSpec(2, 4, 2, 4, 32, 10), GridSpec(3, 2, 2, 2, 8, 10), hidden=16, embedding=3)


def untrained(scene, tmp_path):
    loaded, mesh = load_scene(scene)
    cache = cast(mesh, loaded.frames, tmp_path)
    return cache, FieldModel(SPEC, len(loaded.frames))


def test_exposures_start_where_mean_brightness_is_explained(scene, tmp_path):
    cache, model = untrained(scene, tmp_path)
    start_exposures(model, cache)
    samples = cache.samples(np.arange(len(cache)), torch.device("cpu"))
    with torch.no_grad():
        colour = model.expose(
            model.albedo(samples.uv) * model.light(samples.position, samples.photo), samples.photo
        ).mean(1)
    photo = linear_from_srgb(samples.colour).mean(1)
    for k in range(8):
        ratio = colour[samples.photo == k].mean() / photo[samples.photo == k].mean()
        assert 0.7 < float(ratio) < 1.4


def test_the_gain_does_not_depend_on_how_albedo_and_light_were_split(scene, tmp_path):
    cache, model = untrained(scene, tmp_path)
    ranges = photo_ranges(cache, np.arange(8))
    samples = cache.samples(np.arange(len(cache)), torch.device("cpu"))

    def gained(bias):
        model.albedo.decoder[-1].bias.data[:] = torch.tensor(bias)
        with torch.no_grad():
            return model.albedo(samples.uv) * albedo_gain(model, cache, ranges, seed=0)

    # an untrained albedo is flat, so whatever its tint the rules must give the photos' mean colour
    first, second = gained([0.0, 0.0, 0.0]), gained([1.0, -2.0, 0.5])
    torch.testing.assert_close(first.mean(0), second.mean(0), rtol=2e-2, atol=0.0)


def test_brightest_albedo_is_brought_inside_physical_bounds(scene, tmp_path):
    cache, model = untrained(scene, tmp_path)
    ranges = photo_ranges(cache, np.arange(8))
    samples = cache.samples(np.arange(len(cache)), torch.device("cpu"))
    for bounds in ((0.01, 0.02), (0.95, 0.99)):
        settings = ScaleSettings(bounds=bounds)
        with torch.no_grad():
            albedo = model.albedo(samples.uv) * albedo_gain(model, cache, ranges, 0, settings)
        assert bounds[0] * 0.99 <= float(albedo.amax(1).quantile(0.99)) <= bounds[1] * 1.01
