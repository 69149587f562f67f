"""Gradients by parameter name that are made when they are asked for: a step's update takes tables level by level instead."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Generic, TypeVar

Array = TypeVar("Array")


class Gradients(Mapping[str, Array], Generic[Array]):
    """A mapping of what each function of `makers` returns."""

    def __init__(self, makers: Mapping[str, Callable[[], Array]]) -> None:
        self._makers = makers

    def __getitem__(self, name: str) -> Array:
        return self._makers[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)
