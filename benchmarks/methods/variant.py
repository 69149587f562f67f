"""The product's own command line with its settings changed, for measurements.

    python benchmarks/methods/variant.py '{"traced.directions": 64}' recover SCENE --out DIR

is `dante-w recover SCENE --out DIR` with light from 64 directions. A change is a number of `presets.Preset` under its dotted name.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from dante_w.commands import cli
from dante_w.contract.errors import BAD_INPUT
from dante_w.presets import PRESETS, Preset

#: The final pass goes with the main one, as in the presets, unless it is changed itself.
FOLLOWERS: dict[str, tuple[str, Callable[[int], int]]] = {
    "field.schedule.steps": ("field.final_pass.steps", lambda steps: steps // 4),
    "field.schedule.batch": ("field.final_pass.batch", lambda batch: batch),
}


def main(arguments: Sequence[str]) -> int:
    """Run `dante-w` as all arguments but the first say, with the changes that the first one holds; returns the exit code."""
    try:
        changes = json.loads(arguments[0] if arguments else "")
        if not isinstance(changes, dict):
            raise ValueError("they are no JSON object")
        preset = PRESETS[cli.parse(arguments[1:]).options.preset]
        settings = altered(preset, changes)
    except ValueError as error:
        print(f"variant: the first argument holds the changes, but {error}.", file=sys.stderr)
        return BAD_INPUT
    return cli.main(arguments[1:], settings=settings)


def altered(preset: Preset, changes: Mapping[str, Any]) -> Preset:
    """`preset` with its changes made.

    Raises:
        ValueError: a name that is none, or a value of another kind.
    """
    kinds = {name: type(value) for name, value in numbers(preset).items()}
    for name, value in changes.items():
        if name not in kinds:
            raise ValueError(f"{name!r} is none of {', '.join(kinds)}")
        if type(value) not in (kinds[name], int) or (isinstance(value, bool) and kinds[name] is not bool):
            raise ValueError(f"{name} is {value!r} and must be of type {kinds[name].__name__}")
    wanted = dict(changes)
    for name, (follower, rule) in FOLLOWERS.items():
        if name in wanted:
            wanted.setdefault(follower, rule(wanted[name]))
    for name, value in wanted.items():
        preset = _replaced(preset, name.split("."), value)
    return preset


def numbers(settings: Any, prefix: str = "") -> dict[str, Any]:
    """Every setting of frozen dataclasses within each other under its dotted name."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            found.update(numbers(value, f"{prefix}{field.name}."))
        else:
            found[prefix + field.name] = value
    return found


def _replaced(settings: Any, path: Sequence[str], value: Any) -> Any:
    name, *deeper = path
    inner = _replaced(getattr(settings, name), deeper, value) if deeper else value
    return dataclasses.replace(settings, **{name: inner})


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
