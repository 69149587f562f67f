import numpy as np
import pytest
from dante_w.contract.errors import BadInput
from dante_w.contract.known_colour import KnownColour
from dante_w.contract.known_colour import parse_known_colour as parse
from dante_w.core.color import linear_from_srgb_array
from dante_w.texture.known_colours import gain
from hypothesis import given
from hypothesis import strategies as st

albedos = st.tuples(*[st.floats(0.01, 1.0)] * 3)
places = st.floats(0.0, 1.0)
spots = st.builds(KnownColour, places, places, st.none() | albedos)


def plain(colour, size=8):
    return np.full((size, size, 3), colour, np.float32), np.ones((size, size), bool)


def painted(patches, size=512):
    """A grey texture with squares of colour around texture coordinates, all seen."""
    texture, seen = plain((0.5, 0.5, 0.5), size)
    for (u, v), colour in patches.items():
        row, column = int((1.0 - v) * size), int(u * size)
        texture[row - 8 : row + 8, column - 8 : column + 8] = colour
    return texture, seen


@given(places, places, albedos, albedos)
def test_one_known_colour_is_met_exactly(u, v, albedo, recovered):
    texture, seen = plain(recovered)
    known = KnownColour(u, v, albedo)
    wanted = linear_from_srgb_array(np.array(albedo))
    np.testing.assert_allclose(gain(texture, seen, [known]) * texture[0, 0], wanted, rtol=1e-6)


@given(places, places, albedos)
def test_a_grey_spot_becomes_grey_and_the_level_stays(u, v, recovered):
    texture, seen = plain(recovered)
    found = gain(texture, seen, [KnownColour(u, v, None)])
    assert np.prod(found) == pytest.approx(1.0)
    np.testing.assert_allclose(found * texture[0, 0], np.cbrt(np.prod(texture[0, 0], dtype=float)), rtol=1e-6)


@given(st.lists(spots, min_size=1, max_size=5), st.randoms())
def test_the_order_of_spots_does_not_matter(known, random):
    texture = np.random.default_rng(0).uniform(0.1, 0.9, (16, 16, 3))
    seen = np.ones((16, 16), bool)
    shuffled = random.sample(known, len(known))
    np.testing.assert_allclose(gain(texture, seen, known), gain(texture, seen, shuffled), rtol=1e-12)


@given(st.lists(spots, min_size=1, max_size=5), albedos)
def test_a_gain_on_the_texture_is_taken_back(known, factor):
    texture = np.random.default_rng(0).uniform(0.1, 0.9, (16, 16, 3))
    seen = np.ones((16, 16), bool)
    ratio = gain(texture, seen, known) / gain(texture * factor, seen, known)
    only_grey = all(spot.albedo_srgb is None for spot in known)
    level = np.cbrt(np.prod(factor)) if only_grey else 1.0  # greys leave the level as it is
    np.testing.assert_allclose(ratio * level, factor, rtol=1e-9)


def test_known_colours_are_averaged_geometrically():
    texture, seen = painted({(0.2, 0.3): (0.1, 0.1, 0.1), (0.7, 0.6): (0.4, 0.2, 0.1)})
    white = (1.0, 1.0, 1.0)
    known = [KnownColour(0.2, 0.3, white), KnownColour(0.7, 0.6, white)]
    assert gain(texture, seen, known) == pytest.approx(np.sqrt([10 * 2.5, 10 * 5.0, 10 * 10.0]), rel=1e-6)


def test_level_comes_from_known_colours_alone_tint_from_all_spots():
    texture, seen = painted({(0.2, 0.3): (0.1, 0.1, 0.1), (0.7, 0.6): (0.04, 0.02, 0.01)})
    known = [KnownColour(0.2, 0.3, (1.0, 1.0, 1.0)), KnownColour(0.7, 0.6, None)]
    found = gain(texture, seen, known)
    assert np.cbrt(np.prod(found)) == pytest.approx(10.0)
    assert found / 10.0 == pytest.approx(np.sqrt([0.5, 1.0, 2.0]))


def test_v_points_up():
    texture, seen = plain((0.5, 0.5, 0.5), 64)
    texture[:32] = 0.25
    white = (1.0, 1.0, 1.0)
    assert gain(texture, seen, [KnownColour(0.5, 0.9, white)]) == pytest.approx([4.0] * 3)
    assert gain(texture, seen, [KnownColour(0.5, 0.1, white)]) == pytest.approx([2.0] * 3)


def test_outliers_unseen_and_broken_texels_do_not_count():
    texture, seen = plain((0.5, 0.5, 0.5), 1024)
    disc = (slice(508, 516), slice(508, 516))  # within 4 texels of the middle, with corners
    texture[511:513, 511:513] = 0.9  # the four in the middle of about fifty
    texture[512, 512] = np.nan
    seen[513, 508:516], texture[513, 508:516] = False, 0.1
    assert gain(texture, seen, [KnownColour(0.5, 0.5, (1.0, 1.0, 1.0))]) == pytest.approx([2.0] * 3)
    texture[disc] = 0.25
    assert gain(texture, seen, [KnownColour(0.5, 0.5, (1.0, 1.0, 1.0))]) == pytest.approx([4.0] * 3)


def test_spots_that_say_nothing_are_refused():
    texture, seen = plain((0.5, 0.5, 0.0))
    with pytest.raises(BadInput, match=r"0\.5 0\.25 was recovered as black .* lighter spot"):
        gain(texture, seen, [KnownColour(0.5, 0.25, None)])
    seen[:4] = False
    with pytest.raises(BadInput, match=r"No photo saw the known colour at 0\.5 0\.9;"):
        gain(texture, seen, [KnownColour(0.5, 0.9, None)])
    with pytest.raises(BadInput, match="No photo saw"):
        gain(texture, np.ones_like(seen), [KnownColour(1.5, -0.4, None)])


def test_the_words_of_the_command_line():
    assert parse("0.25", "1", "grey") == KnownColour(0.25, 1.0, None)
    assert parse("0", "5e-1", "#33Ff66") == KnownColour(0.0, 0.5, (0.2, 1.0, 0.4))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("left", "0.5", "grey"), "numbers from 0 to 1"),
        (("0.5", "1.01", "grey"), "numbers from 0 to 1"),
        (("nan", "0.5", "grey"), "numbers from 0 to 1"),
        (("0.5", "0.5", "red"), "grey, or an sRGB colour"),
        (("0.5", "0.5", "#12345"), "grey, or an sRGB colour"),
        (("0.5", "0.5", "#FF0010"), "channel of 0"),
    ],
)
def test_words_that_make_no_sense_are_refused(words, said):
    with pytest.raises(ValueError, match=said) as refusal:
        parse(*words)
    assert str(refusal.value).startswith(" ".join(words))
