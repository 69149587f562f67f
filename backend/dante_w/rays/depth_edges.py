"""How far a photo's pixels are from where its depth jumps: there colours mix, and a mesh is seldom right to the pixel."""

from __future__ import annotations

import numpy as np

#: Distances from here up are all stored as this.
REACH = 8
#: A neighbour this many pixels' widths nearer or farther lies across an edge: a surface so steep is not looked at.
STEEP = 10.0


def edge_distances(depth: np.ndarray, focal: float) -> np.ndarray:
    """(H, W) uint8: steps, also diagonal ones, from a pixel to the next one beside an edge; 0 beside it, at most `REACH`.

    The border of the photo is no edge.

    Args:
        depth: (H, W) along the camera's axis, 0 where a pixel shows no mesh or is not to be explained.
        focal: length in pixels.

    >>> edge_distances(np.array([[0.0, 2.0, 2.0, 2.0, 5.0]]), 100.0).tolist()
    [[0, 0, 1, 0, 0]]
    """
    far = np.full(depth.shape, REACH, np.uint8)
    for near, across in (
        (np.s_[:, 1:], np.s_[:, :-1]),
        (np.s_[1:], np.s_[:-1]),
    ):
        a, b = depth[near], depth[across]
        jump = np.abs(a - b) > STEEP / focal * np.minimum(a, b)
        far[near][jump] = 0
        far[across][jump] = 0
    for step in range(1, REACH):
        reached = far < step
        reached[1:] |= reached[:-1].copy()
        reached[:-1] |= reached[1:].copy()
        reached[:, 1:] |= reached[:, :-1].copy()
        reached[:, :-1] |= reached[:, 1:].copy()
        far[reached & (far > step)] = step
    return far
