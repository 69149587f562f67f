"""Which samples of the ray cache a step of the fit sees.

Samples are drawn in runs of neighbours in a photo's row: they share table entries, so memory is touched less often. A cache
may be larger than memory; then only some blocks of it are drawn from at a time, and a few of them are replaced
after every batch, so that a file is read in pieces and each piece once in a while.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class DrawingSettings:
    """How samples are drawn. With few samples in memory at a time, accuracy stays and a file is read in order."""

    #: Neighbouring samples drawn together.
    run: int = 16
    #: Samples in a block, the last of a photo aside.
    block: int = 1 << 12
    #: Samples that are drawn from at a time where there are more: 300 MB of the cache.
    pool: int = 1 << 24
    #: Samples that become new to the pool after each batch, in batches.
    fresh: int = 2


DRAWING = DrawingSettings()


def batches(
    ranges: np.ndarray, batch: int, seed: int, skipped: int = 0, settings: DrawingSettings = DRAWING
) -> Iterator[np.ndarray]:
    """Endless random batches of sample indices from ranges (R, 2) of the cache, in runs of neighbours.

    Every sample is drawn with the same probability. With fewer samples than a batch, samples repeat. The first
    `skipped` batches are left out.
    """
    generator = np.random.default_rng(seed)
    if (ranges[:, 1] - ranges[:, 0]).sum() <= settings.pool:
        pools = _all(ranges)
    else:
        fresh = max(settings.fresh * batch // settings.block, 1)
        pools = _in_turn(blocks(ranges, settings.block), settings.pool // settings.block, fresh, generator)
    within = np.arange(settings.run)
    runs = max(batch // settings.run, 1)
    while True:
        pool = next(pools)
        lengths = pool[:, 1] - pool[:, 0]
        ends = np.cumsum(lengths)
        ranks = generator.integers(0, ends[-1], runs)
        if skipped > 0:
            skipped -= 1
            continue
        piece = np.searchsorted(ends, ranks, side="right")
        length = lengths[piece]
        # a run that reaches the end of its range goes on at its start: no sample is drawn less often
        place = (ranks - (ends[piece] - length))[:, None] + within
        yield (pool[piece, :1] + place % length[:, None]).reshape(-1)


def blocks(ranges: np.ndarray, block: int) -> np.ndarray:
    """(B, 2): ranges (R, 2) cut into pieces of `block` samples, the last of each as long as what is left."""
    counts = -(-(ranges[:, 1] - ranges[:, 0]) // block)
    source = np.repeat(np.arange(len(ranges)), counts)
    first = ranges[source, 0] + block * (
        np.arange(len(source)) - np.repeat(np.cumsum(counts) - counts, counts)
    )
    return np.stack([first, np.minimum(first + block, ranges[source, 1])], axis=1)


def _all(ranges: np.ndarray) -> Iterator[np.ndarray]:
    while True:
        yield ranges


def _in_turn(
    pieces: np.ndarray, count: int, fresh: int, generator: np.random.Generator
) -> Iterator[np.ndarray]:
    """`count` of the pieces (B, 2), of which the `fresh` oldest are replaced each time; all come once before one comes
    again."""
    order = _shuffled(len(pieces), generator)
    pool = pieces[[next(order) for _ in range(count)]]
    oldest = 0
    while True:
        yield pool
        for _ in range(fresh):
            pool[oldest] = pieces[next(order)]
            oldest = (oldest + 1) % count


def _shuffled(count: int, generator: np.random.Generator) -> Iterator[int]:
    while True:
        yield from generator.permutation(count)
