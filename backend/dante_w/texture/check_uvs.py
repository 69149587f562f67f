"""Whether a texture can be painted through a mesh's UVs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dante_w.contract.errors import BadInput
from dante_w.texture.rasterise import bin_faces, count_bins, rasterise_bins


@dataclass(frozen=True)
class UvSettings:
    """What UVs may do."""

    #: Sides of the texture by which UVs may lie outside 0 to 1: rounding.
    outside: float = 1e-4
    #: Area of all triangles, in squared sides of the texture, below which there is nothing to paint on.
    least_area: float = 5e-13
    #: Share of the texels on the mesh that may lie in several places: they can have one albedo alone.
    overlap: float = 0.01
    #: Texels a side at which overlap is measured.
    side: int = 1024
    #: Texels of these: charts that touch, or overlap by a rounding error, are fine.
    margin: float = 0.25


UVS = UvSettings()
#: Rows rasterised at once.
_BAND = 64


def check_uvs(uvs: np.ndarray | None, mesh: str | Path, settings: UvSettings = UVS) -> None:
    """Make sure that a texture can be painted through UVs.

    Args:
        uvs: (F, 3, 2) of the faces' corners, or None for a mesh without.
        mesh: its name, for messages.

    Raises:
        BadInput: there are none, some are not finite or outside 0 to 1, no triangle has an area, or more than 1% of the
            texels on the mesh lie in several places. Names the mesh and the fix.
    """
    fix = "run again with --unwrap to make new ones."
    if uvs is None or uvs.size == 0:
        raise BadInput(f"{mesh} has no UVs: {fix}")
    if not np.isfinite(uvs).all():
        raise BadInput(f"{mesh} has UVs that are not finite numbers: {fix}")
    low, high = float(uvs.min()), float(uvs.max())
    if low < -settings.outside or high > 1 + settings.outside:
        raise BadInput(
            f"{mesh} has UVs from {low:.4g} to {high:.4g}, outside 0 to 1 (UDIM tiles are not supported yet): {fix}"
        )
    edge, other = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    area = 0.5 * float(np.abs(edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0]).sum())
    if area < settings.least_area:
        raise BadInput(f"{mesh} has UVs without any area: {fix}")
    overlap = overlap_fraction(uvs, settings.side, settings.margin)
    if overlap > settings.overlap:
        raise BadInput(f"{mesh} has UVs that overlap on {overlap:.0%} of their area: {fix}")


def overlap_fraction(uvs: np.ndarray, size: int = UVS.side, margin: float = UVS.margin) -> float:
    """Share of the texels on the mesh whose centre lies well inside two or more UV triangles.

    Args:
        uvs: (F, 3, 2), rasterised at size x size.
        margin: texels from every edge that count as well inside, see `rasterise.count_bins`.

    Returns:
        0 when no triangle covers a texel.
    """
    bins = bin_faces(uvs, size, size)
    on_mesh = overlapping = 0
    for start in range(0, size, _BAND):
        rows = (start, min(start + _BAND, size))
        count = count_bins(bins, rows, margin)
        on_mesh += int(np.count_nonzero((rasterise_bins(bins, rows) >= 0) | (count > 0)))
        overlapping += int(np.count_nonzero(count > 1))
    return overlapping / on_mesh if on_mesh else 0.0
