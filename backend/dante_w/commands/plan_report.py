"""The plan: what a run models and how large, a line each, with its reason and what it costs."""

from __future__ import annotations

import math

import numpy as np

from dante_w.contract.protocol import YOU_CHOSE, Decision
from dante_w.contract.text import duration, gigabytes
from dante_w.estimate.memory import TRANSFER
from dante_w.field.fields import FieldSpec
from dante_w.rays.footprint import sharp_footprint
from dante_w.rays.ray_cache import sample_bytes

#: Texels along a side that a plan takes at least.
LEAST_SIDE = 256


def texture_side(
    footprint: np.ndarray, most: int, chosen: int | None, texel: int, free: int
) -> tuple[int, Decision]:
    """Texels along a side of the texture: the least power of two at which all but the sharpest quarter of the pixels are a texel
    wide or more. On the four objects of the README, 1024 texels then, 2048 are worth no more (0.01 dB after
    gain) and 512 cost 0.2 dB.

    Args:
        footprint: (N,) of some pixels, as parts of the texture's side; none if nothing is known.
        most: what the preset takes at most.
        chosen: by the user, whatever the rest says.
        texel: bytes that one takes while the texture is made, of so many that are `free`.
    """
    if chosen:
        return chosen, _texture(chosen, texel, YOU_CHOSE)
    if not len(footprint):
        return most, _texture(
            most, texel, "no pixel that was tried sees the mesh, so it is the preset's most"
        )
    wanted = 1.0 / sharp_footprint(footprint)
    side = min(1 << math.ceil(math.log2(max(wanted, LEAST_SIDE))), most)
    reason = f"the photos' sharper pixels are {wanted:,.0f} to its side"
    if side < wanted:
        reason += ", the preset takes no more"
    while side > LEAST_SIDE and texel * side**2 > free:
        side //= 2
        if "memory" not in reason:
            reason += ", memory carries no more"
    return side, _texture(side, texel, reason)


def _texture(side: int, texel: int, reason: str) -> Decision:
    costs = f"{gigabytes(texel * side**2)} of memory while it is made, four times that for twice the side"
    return Decision("texture", f"{side} x {side}", reason, costs)


def light(irradiance: str, chosen: bool) -> Decision:
    """Which model of light: `traced` or `field`."""
    if irradiance == "field":
        costs = "a fit by gradient descent, with a prior for a good result"
        return Decision("light", "the paper's field", YOU_CHOSE, costs)
    reason = YOU_CHOSE if chosen else "the mesh tells which light reaches it, and no prior is needed"
    return Decision("light", "traced through the mesh", reason, "rays from every shading point")


def normals(own: bool) -> Decision:
    """How the surface is turned, see `rays.normals`."""
    choice, reason = "smooth, but for edges", "the mesh's file has none, and a scan's facets are no shading"
    if own:
        choice, reason = "the mesh's own", "its file has some"
    return Decision("normals", choice, reason, "36 bytes a face")


def directions(count: int, preset: str, points: int) -> Decision:
    """From how many directions light comes."""
    costs = f"{gigabytes(TRANSFER * points * count)} for {points:,} shading points; seconds grow with them, squared"
    return Decision("directions", str(count), f"the preset {preset}", costs)


def samples(count: int, pixels: int, prior: bool) -> Decision:
    """How many of the photos' pixels are used."""
    each = sample_bytes(prior)
    return Decision(
        "samples",
        f"{count:,} of {pixels:,} pixels",
        "all that see the mesh, but masked and grazing ones",
        f"{gigabytes(count * each)}, {each} bytes each",
    )


def representation(spec: FieldSpec) -> Decision:
    """What the paper's model keeps its albedo in."""
    grid = spec.albedo
    return Decision(
        "albedo",
        f"hash encoding to {grid.finest}",
        "the paper's model keeps albedo in one",
        f"{sum(grid.entries) * grid.features / 1e6:.1f} million numbers",
    )


def embedding(length: int) -> Decision:
    """How the paper's model tells the photos' lights apart."""
    reason = "the paper's model gives each photo a light of its own; doing without is not tried"
    return Decision("embedding", "on", reason, f"{length} numbers a photo")


def own_exposures() -> Decision:
    """How the paper's model tells the photos' exposures apart."""
    reason = "the paper's model has them always; doing without is not tried"
    return Decision("exposures", "on", reason, "a gain and an offset a photo and channel")


def memory(needed: int, there: int, parts: dict[str, int]) -> Decision:
    """Bytes that are `needed` at most and that are `there`; `parts` has those of each part at that moment."""
    reason = (
        "it fits" if needed <= there else "that is more than there is: choose a smaller texture or preset"
    )
    costs = ", ".join(f"{name} {gigabytes(each)}" for name, each in parts.items())
    return Decision("memory", f"about {gigabytes(needed)} of {gigabytes(there)}", reason, costs)


def time(seconds: dict[str, float]) -> Decision:
    """What a recovery takes from its start, by stage."""
    parts = ", ".join(f"{stage} {each:.0f} s" for stage, each in seconds.items() if each >= 0.5)
    return Decision(
        "time", f"about {duration(sum(seconds.values()))}", "this machine's pace, timed on this scene", parts
    )
