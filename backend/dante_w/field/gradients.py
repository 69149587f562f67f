"""Gradients by parameter name that are made when they are asked for: a fit's step takes tables level by level instead."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Generic, TypeVar

Array = TypeVar("Array")


class Gradients(Mapping[str, Array], Generic[Array]):
    """A mapping of what `made` returns for each name."""

    def __init__(self, made: Mapping[str, Callable[[], Array]]) -> None:
        self._made = made

    def __getitem__(self, name: str) -> Array:
        return self._made[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)
