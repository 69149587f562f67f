"""A spot of the texture whose albedo the user knows, as `--known U V COLOUR` names it."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class KnownColour:
    """A spot of the texture whose albedo is known.

    `u`, `v` texture coordinates in [0, 1], v up; `albedo_srgb` the sRGB albedo there, or None for a grey of
    unknown scale.
    """

    u: float
    v: float
    albedo_srgb: tuple[float, float, float] | None

    def __str__(self) -> str:
        return f"known colour at {self.u:g} {self.v:g}"


def parse_known_colour(text_u: str, text_v: str, text_colour: str) -> KnownColour:
    """A known colour from the words of `--known U V COLOUR`; COLOUR is `grey` or sRGB `#RRGGBB`.

    Raises:
        ValueError: one sentence for the user.
    """
    words = f"{text_u} {text_v} {text_colour}"
    try:
        u, v = float(text_u), float(text_v)
    except ValueError:
        u = v = -1.0
    if not (0.0 <= u <= 1.0 and 0.0 <= v <= 1.0):
        raise ValueError(f"{words}: U and V are texture coordinates, numbers from 0 to 1")
    if text_colour == "grey":
        return KnownColour(u, v, None)
    if not re.fullmatch("#[0-9a-fA-F]{6}", text_colour):
        raise ValueError(f"{words}: COLOUR is grey, or an sRGB colour like #7A7A79")
    red, green, blue = bytes.fromhex(text_colour[1:])
    if min(red, green, blue) == 0:
        raise ValueError(f"{words}: a colour with a channel of 0 fixes no gain; choose another spot")
    return KnownColour(u, v, (red / 255.0, green / 255.0, blue / 255.0))
