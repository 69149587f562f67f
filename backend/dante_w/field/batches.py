"""Which samples of the ray cache a step of the fit sees.

Samples are drawn in runs of neighbours in a photo's row: they share table entries, so memory is touched less often. A cache
may be larger than memory; then only some blocks of it are drawn from at a time, and a few of them give way to others
after every batch, so that a file is read in pieces and each piece once in a while.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

#: Samples drawn as one run.
RUN = 16
#: Samples in a block, and samples that are drawn from at a time where there are more: 300 MB of the cache.
BLOCK, POOL = 1 << 12, 1 << 24
#: Samples that become new to the pool after each batch, in batches.
FRESH = 2


def batches(ranges: np.ndarray, batch: int, seed: int, behind: int = 0) -> Iterator[np.ndarray]:
    """Endless random batches of sample indices from ranges (R, 2) of the cache, in runs of `RUN` neighbours.

    Every sample is drawn with the same probability. With fewer samples than a batch, samples repeat. The first
    `behind` batches are passed over.
    """
    generator = np.random.default_rng(seed)
    if (ranges[:, 1] - ranges[:, 0]).sum() <= POOL:
        pools = _all(ranges)
    else:
        pools = _in_turn(blocks(ranges), POOL // BLOCK, max(FRESH * batch // BLOCK, 1), generator)
    within = np.arange(RUN)
    runs = max(batch // RUN, 1)
    while True:
        pool = next(pools)
        lengths = pool[:, 1] - pool[:, 0]
        ends = np.cumsum(lengths)
        ranks = generator.integers(0, ends[-1], runs)
        if behind > 0:
            behind -= 1
            continue
        which = np.searchsorted(ends, ranks, side="right")
        length = lengths[which]
        # a run that reaches the end of its range goes on at its start: no sample is drawn less often
        place = (ranks - (ends[which] - length))[:, None] + within
        yield (pool[which, :1] + place % length[:, None]).reshape(-1)


def blocks(ranges: np.ndarray) -> np.ndarray:
    """(B, 2): ranges (R, 2) cut into pieces of `BLOCK` samples, the last of each as long as what is left."""
    counts = -(-(ranges[:, 1] - ranges[:, 0]) // BLOCK)
    own = np.repeat(np.arange(len(ranges)), counts)
    first = ranges[own, 0] + BLOCK * (np.arange(len(own)) - np.repeat(np.cumsum(counts) - counts, counts))
    return np.stack([first, np.minimum(first + BLOCK, ranges[own, 1])], axis=1)


def _all(ranges: np.ndarray) -> Iterator[np.ndarray]:
    while True:
        yield ranges


def _in_turn(
    pieces: np.ndarray, count: int, fresh: int, generator: np.random.Generator
) -> Iterator[np.ndarray]:
    """`count` of the pieces (B, 2), of which the `fresh` oldest give way to others each time; all come once before one comes
    again."""
    coming = _shuffled(len(pieces), generator)
    pool = pieces[[next(coming) for _ in range(count)]]
    oldest = 0
    while True:
        yield pool
        for _ in range(fresh):
            pool[oldest] = pieces[next(coming)]
            oldest = (oldest + 1) % count


def _shuffled(count: int, generator: np.random.Generator) -> Iterator[int]:
    while True:
        yield from generator.permutation(count)
