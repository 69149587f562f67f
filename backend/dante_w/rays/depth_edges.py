"""How far a photo's pixels are from where its depth jumps: there colours mix, and a mesh is seldom right to the pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class EdgeSettings:
    """What counts as an edge in depth, and how far from it pixels are told apart."""

    #: Steps: distances from here up are all stored as this, below 256.
    reach: int = 8
    #: Depth over the width of a pixel there. A neighbour so many widths nearer or farther lies across an edge: no surface
    #: so steep to the ray is of use.
    steepness: float = 10.0


EDGES = EdgeSettings()


def edge_distances(depth: np.ndarray, focal: float, settings: EdgeSettings = EDGES) -> np.ndarray:
    """(H, W) uint8: steps, also diagonal ones, from a pixel to the next one beside an edge; 0 beside it, at most `reach`.

    The border of the photo is no edge. By hand, as scipy, which has the distance, is no dependency of the backend.

    Args:
        depth: (H, W) along the camera's axis in any unit, 0 where a pixel shows no mesh or is not to be explained.
        focal: length in pixels.

    >>> edge_distances(np.array([[0.0, 2.0, 2.0, 2.0, 5.0]]), 100.0).tolist()
    [[0, 0, 1, 0, 0]]
    """
    distance = np.full(depth.shape, settings.reach, np.uint8)
    for first, second in (
        (np.s_[:, 1:], np.s_[:, :-1]),
        (np.s_[1:], np.s_[:-1]),
    ):
        a, b = depth[first], depth[second]
        jump = np.abs(a - b) > settings.steepness / focal * np.minimum(a, b)
        distance[first][jump] = 0
        distance[second][jump] = 0
    for step in range(1, settings.reach):
        reached = distance < step
        reached[1:] |= reached[:-1].copy()
        reached[:-1] |= reached[1:].copy()
        reached[:, 1:] |= reached[:, :-1].copy()
        reached[:, :-1] |= reached[:, 1:].copy()
        distance[reached & (distance > step)] = step
    return distance
