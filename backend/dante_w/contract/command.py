"""The command line by which the add-on asks the backend for a recovery."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Request:
    """What to recover, and how; words and keys are the vocabulary's.

    Attributes:
        scene: the scene folder.
        out: the result folder.
        model: how light is modelled.
        preset: quality against time.
        texture_size: texels along a side, 0 for as fine as the photos are.
        file_format: of the albedo texture.
        device: what the paper's model computes on.
        priors: folder of albedo images named like the photos, None for none.
        unwrap: whether to make new UVs.
        known: U, V and COLOUR of spots whose albedo is known; COLOUR is `grey` or sRGB as `#RRGGBB`.
        components: components of traced light to model whatever the plan finds.
        left_out: components of traced light not to model.
    """

    scene: Path
    out: Path
    model: str = "traced"
    preset: str = "standard"
    texture_size: int = 0
    file_format: str = "png"
    device: str = "auto"
    priors: Path | None = None
    unwrap: bool = False
    known: tuple[tuple[str, str, str], ...] = ()
    components: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def arguments(self) -> list[str]:
        """The words after the program's name. The backend writes JSON lines then."""
        words: list[str] = ["recover", str(self.scene), "--out", str(self.out), "--json"]
        words += ["--irradiance", self.model, "--preset", self.preset, "--format", self.file_format]
        if self.model == "field":
            words += ["--device", self.device]
        if self.texture_size:
            words += ["--texture-size", str(self.texture_size)]
        if self.priors is not None:
            words += ["--priors", str(self.priors)]
        if self.unwrap:
            words.append("--unwrap")
        for spot in self.known:
            words += ["--known", *spot]
        return [*words, *_repeated("--model", self.components), *_repeated("--leave-out", self.left_out)]


def _repeated(option: str, values: Sequence[str]) -> list[str]:
    return [word for value in values for word in (option, value)]
