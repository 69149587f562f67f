import torch
from dante_w.field.fields import FieldModel, FieldSpec
from dante_w.field.hash_encoding import GridSpec

SPEC = FieldSpec(GridSpec(2, 4, 2, 4, 32, 10), GridSpec(3, 2, 2, 2, 8, 10), hidden=16, embedding=3)


def test_colour_is_the_paper_equation():
    model = FieldModel(SPEC, photos=4)
    torch.nn.init.normal_(model.log_exposure)
    torch.nn.init.normal_(model.offset)
    position, photo = torch.rand(50, 3), torch.randint(0, 4, (50,))
    albedo = model.albedo(torch.rand(50, 2))
    irradiance = model.irradiance(position, model.embedding[photo])
    expected = model.log_exposure[photo].exp() * albedo * irradiance + model.offset[photo]
    colour = model.expose(albedo * model.light(position, photo), photo)
    torch.testing.assert_close(colour, expected)


def test_albedo_is_bounded_and_irradiance_is_not_negative_nor_capped():
    model = FieldModel(SPEC, photos=2)
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=30.0)
    albedo = model.albedo(torch.rand(500, 2))
    irradiance = model.irradiance(torch.rand(500, 3), model.embedding[torch.randint(0, 2, (500,))])
    assert albedo.min() >= 0.0 and albedo.max() <= 1.0
    assert irradiance.min() >= 0.0 and irradiance.max() > 10.0


def test_the_same_place_has_another_light_in_another_photo():
    model = FieldModel(SPEC, photos=2)
    position = torch.rand(10, 3)
    first, second = (model.irradiance(position, model.embedding[[k] * 10]) for k in (0, 1))
    assert (first - second).abs().max() > 1e-5
