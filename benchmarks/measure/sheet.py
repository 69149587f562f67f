"""One picture per object: albedo, its error and a relight, side by side for the rows worth looking at."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
import OpenImageIO as oiio  # noqa: N813
from measure.pictures import PAPER, caption, grid, trim, write
from measure.score import View

TILE = 155
#: sRGB error that is shown as white.
WORST = 0.25


class Column(NamedTuple):
    """One method's pictures in the view that is shown: (H, W, 3) sRGB."""

    title: str
    note: str
    albedo: np.ndarray
    relit: np.ndarray


def write_sheet(file: Path, truth: View, relit_truth: np.ndarray, columns: Sequence[Column]) -> None:
    """Write the picture of one object: the truth first, then `columns`; `truth` is its albedo (no picture)."""
    alpha = truth.mask.astype(np.float32)
    shown = [Column("truth", "", truth.truth, relit_truth), *columns]
    albedo = [_on_paper(column.albedo, alpha) for column in shown]
    lit = [_on_paper(column.relit, alpha) for column in shown]
    error = [_on_paper(_heat(column.albedo, truth.truth), alpha) for column in shown]
    rows = [[_small(tile) for tile in trim(row)] for row in (albedo, error, lit)]
    words = zip(rows[-1], shown, strict=True)
    rows[-1] = [caption(tile, column.title, column.note) for tile, column in words]
    write(file, np.concatenate([grid([row], gap=6) for row in rows]))


def _heat(picture: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean absolute sRGB error as a colour: black none, light WORST or more."""
    difference = np.abs(picture - truth).mean(axis=-1) / WORST
    return matplotlib.colormaps["inferno"](np.clip(difference, 0.0, 1.0))[..., :3]


def _on_paper(picture: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return (picture * alpha[..., None] + PAPER * (1.0 - alpha[..., None])).astype(np.float32)


def _small(picture: np.ndarray) -> np.ndarray:
    height, width, _ = picture.shape
    size = oiio.ROI(0, TILE, 0, round(height * TILE / width), 0, 1, 0, 3)
    buffer = oiio.ImageBuf(np.ascontiguousarray(picture, np.float32))
    return oiio.ImageBufAlgo.resize(buffer, roi=size).get_pixels(oiio.FLOAT)
