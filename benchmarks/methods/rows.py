"""The rows of the GigaLit table: every method, and how its texture is made."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from measure.command import ROOT, dante_w
from methods.stand_in_prior import STRENGTHS, make_priors

NO_PRIOR = "none"
#: The preset that plays "ours full" and its ablations: `paper` itself wants a GPU.
FULL = "standard"
#: The paper's model; without it, light is traced.
FIELD = ("recover", "--irradiance", "field")


@dataclass(frozen=True)
class Method:
    """One row. `tool` is "dante-w", "lagrange", "truth" (the ceiling) or "raw prior" (a picture per view)."""

    name: str
    tool: str
    arguments: tuple[str, ...] = ()
    prior: str = NO_PRIOR

    @property
    def slug(self) -> str:
        """The row's name for files."""
        words = self.name if self.prior == NO_PRIOR else f"{self.name} {self.prior}"
        return "-".join("".join(c if c.isalnum() else " " for c in words).split())

    def key(self, scene: Path) -> str:
        """A folder name that changes when the row, the scene or the code behind it does."""
        parts = [self.tool, *self.arguments, self.prior, str(STRENGTHS.get(self.prior))]
        digest = hashlib.sha256(json.dumps(parts).encode())
        for file in (scene / "transforms_train.json", scene / "mesh.obj", *sources(self.tool)):
            digest.update(file.read_bytes())
        return f"{self.slug}-{digest.hexdigest()[:10]}"


def sources(tool: str) -> list[Path]:
    """The code that a tool's result hangs on."""
    own = {"lagrange": ["lagrange_texturing.py"], "raw prior": ["stand_in_prior.py"], "truth": []}
    ours = ["stand_in_prior.py", *sorted((ROOT / "backend/dante_w").rglob("*.py"))]
    return [ROOT / "benchmarks/methods" / file for file in own.get(tool, ours)]


def methods(presets: Sequence[str], priors: Sequence[str]) -> Iterator[Method]:
    """Every row, in the order of the table; `priors` are names of `STRENGTHS` or "none"."""
    yield Method("true texture", "truth")
    yield Method("photos averaged", "dante-w", ("average",))
    yield Method("gradient-domain texturing", "lagrange")
    for prior in priors:
        if prior != NO_PRIOR:
            yield Method("raw prior", "raw prior", prior=prior)
        yield Method("ours, traced light", "dante-w", ("recover",), prior)
        for preset in ("draft", "high"):
            yield Method(f"ours, traced light, {preset}", "dante-w", ("recover", "--preset", preset), prior)
        if prior != NO_PRIOR:
            yield Method("ours w/o PR", "dante-w", (*FIELD, "--preset", FULL, "--no-photometric"), prior)
        yield Method("ours, equal bands", "dante-w", (*FIELD, "--preset", FULL, "--equal-bands"), prior)
        for preset in presets:
            name = f"ours full (paper), {preset}" if preset == FULL else f"ours, {preset}"
            yield Method(name, "dante-w", (*FIELD, "--preset", preset), prior)


def make(method: Method, scene: Path, out: Path) -> float:
    """Put the method's result into `out` unless it is there; returns the seconds that it took."""
    note = out / "seconds.json"
    if not note.is_file():
        note.parent.mkdir(parents=True, exist_ok=True)
        seconds = _run(method, scene, out)
        note.write_text(json.dumps(seconds), encoding="utf-8")  # last: the result is whole
    return float(json.loads(note.read_text(encoding="utf-8")))


def texture_of(method: Method, scene: Path, out: Path) -> Path:
    """The texture file of a finished row (the true one for the ceiling)."""
    if method.tool == "truth":
        return next(scene.glob("albedo_gt.*"))
    return out / "albedo.png"


def priors_of(method: Method, scene: Path, out: Path) -> Path:
    """The folder of the stand-in priors of a row, made when they are not there yet."""
    code = (ROOT / "benchmarks/methods/stand_in_prior.py").read_bytes()
    digest = hashlib.sha256(code + (scene / "transforms_train.json").read_bytes()).hexdigest()[:10]
    folder = out.parent / f"priors-{method.prior}-{digest}"
    if not (folder / "whole").is_file():
        make_priors(scene, STRENGTHS[method.prior], folder)
        (folder / "whole").touch()
    return folder


def _run(method: Method, scene: Path, out: Path) -> float:
    start = time.monotonic()
    if method.tool == "dante-w":
        given = [] if method.prior == NO_PRIOR else ["--priors", str(priors_of(method, scene, out) / "train")]
        command, *options = method.arguments
        mesh = ["--mesh", str(scene / "mesh.obj")]
        return dante_w([command, str(scene), *mesh, *given, *options], out)[1]
    if method.tool == "lagrange":
        script = ROOT / "benchmarks/methods/lagrange_texturing.py"
        if subprocess.call([sys.executable, str(script), str(scene), "--out", str(out)]):
            sys.exit(f"{scene}: gradient-domain texturing failed; see above.")
    elif method.tool == "raw prior":
        priors_of(method, scene, out)
        return 0.0
    return time.monotonic() - start
