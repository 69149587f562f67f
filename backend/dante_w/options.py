"""What a user asks of a run, as data: the command line, the add-on's headless run and Python callers all come to this."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dante_w.contract.known_colour import KnownColour


@dataclass(frozen=True)
class RecoverOptions:
    """The options of `recover`; `plan` and `average` use those that apply to them.

    Attributes:
        scene: scene folder, transforms file, or the parent of a COLMAP model.
        out: folder for the result; None for a plan alone.
        mesh, images: where the mesh and a COLMAP model's photos are, if not in the scene.
        priors: folder of albedo images (sRGB) named like the photos.
        preset: a name of `contract.vocabulary.PRESETS`.
        irradiance: a name of `contract.vocabulary.MODELS`; None takes traced light.
        texture_size: texels along a side; None lets the plan choose.
        format: a name of `contract.vocabulary.FORMATS`.
        unwrap: make new UVs.
        known: places of known albedo on the texture.
        model, leave_out: components of the light (`contract.vocabulary.COMPONENTS`, names or keys) that are modelled, or not,
            whatever the plan finds.
        prior_weight: weight of the priors, from 0 up; 1 is usual (lambda of the paper, equation 7).
        device: a name of `contract.vocabulary.DEVICES`; only the paper's model asks for it.
        seed: of all random choices.
        resume: go on from what a killed run with the same inputs and options has kept.
        keep_held_out: the paper's model is never fitted to the held-out photos.
        no_photometric, equal_bands: the paper's ablations.
    """

    scene: Path
    out: Path | None = None
    mesh: Path | None = None
    images: Path | None = None
    priors: Path | None = None
    preset: str = "standard"
    irradiance: str | None = None
    texture_size: int | None = None
    format: str = "png"
    unwrap: bool = False
    known: tuple[KnownColour, ...] = ()
    model: tuple[str, ...] = ()
    leave_out: tuple[str, ...] = ()
    prior_weight: float = 1.0
    device: str = "auto"
    seed: int = 0
    resume: bool = False
    keep_held_out: bool = False
    no_photometric: bool = False
    equal_bands: bool = False

    @property
    def uses_field(self) -> bool:
        """Whether the paper's model is to be fitted, which its ablations imply."""
        return self.irradiance == "field" or self.no_photometric or self.equal_bands or self.keep_held_out


@dataclass(frozen=True)
class Call:
    """One command line: `command` is recover, plan, average or doctor; with `json`, messages are JSON lines."""

    command: str
    options: RecoverOptions
    json: bool = False
