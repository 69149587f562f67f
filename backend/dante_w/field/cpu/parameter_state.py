"""A parameter while it is fitted on the CPU: its value, Adam's moments, and its gradient, part by part."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from queue import Empty, SimpleQueue

import numpy as np
import torch

from dante_w.field.cpu.kernels.adam import adam
from dante_w.field.step import AllReduce

#: Adds the gradient of a part, by its number, to an array of that part's shape.
AddGradient = Callable[[int, np.ndarray], None]


class Buffers:
    """Room for a gradient of up to `longest` numbers, for each thread that is at one: 0 before and after."""

    def __init__(self, longest: int) -> None:
        self._longest, self._free = longest, SimpleQueue[np.ndarray]()

    @contextmanager
    def borrow(self) -> Iterator[np.ndarray]:
        try:
            buffer = self._free.get_nowait()
        except Empty:
            buffer = np.zeros(self._longest, np.float32)
        yield buffer
        self._free.put(buffer)


class ParameterState:
    """A parameter in `parts` from row to row, which are the levels of a table, and what Adam remembers of it (`moments`).

    Between a step's `gradients` and `update`, `add_gradient` adds a part's gradient to an array; None: the gradient is 0.
    So a gradient is made and used up part by part, while it is in the processor's cache.
    """

    def __init__(self, value: np.ndarray, cuts: Sequence[int]) -> None:
        self._value = value
        self.moments = [np.zeros_like(value) for _ in range(2)]
        self.parts = [slice(first, end) for first, end in itertools.pairwise(cuts)]
        self.longest = max(self.length(part) for part in range(len(self.parts)))
        self.add_gradient: AddGradient | None = None

    def length(self, part: int) -> int:
        """Numbers in a part."""
        return self._value[self.parts[part]].size

    def gradient(self) -> np.ndarray:
        """All of the gradient, of the parameter's shape."""
        whole = np.zeros_like(self._value)
        for number, part in enumerate(self.parts):
            if self.add_gradient:
                self.add_gradient(number, whole[part])
        return whole

    def update(
        self,
        part: int,
        buffers: Buffers,
        step: np.float32,
        root: np.float32,
        all_reduce: AllReduce | None,
    ) -> None:
        """Adam's step on one part; `step` and `root` as `kernels.adam` takes them."""
        values = [array[self.parts[part]] for array in (self._value, *self.moments)]
        with buffers.borrow() as buffer:
            gradient = buffer[: values[0].size].reshape(values[0].shape)
            if self.add_gradient:
                self.add_gradient(part, gradient)
            if all_reduce:
                all_reduce(torch.from_numpy(gradient))
            adam(*(array.reshape(-1) for array in (*values, gradient)), step, root)
