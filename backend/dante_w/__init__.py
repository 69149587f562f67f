"""Recover the diffuse albedo texture of a UV-mapped mesh from posed photos (DANTE-W).

    from pathlib import Path
    from dante_w import RecoverOptions, recover

    report = recover(RecoverOptions(Path("scene"), out=Path("result"), preset="draft"))

The package never imports bpy; `contract` needs nothing beyond numpy, so that the Blender add-on uses the very same modules.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from dante_w.options import RecoverOptions

if TYPE_CHECKING:  # it imports torch, which takes seconds
    from dante_w.presets import Preset

__all__ = ["RecoverOptions", "recover"]

__version__ = "0.1.0"

# Idle OpenMP threads must sleep, not spin: torch and numba take turns on the same cores, and so does Blender.
# Measured on two cores, a step of the fit takes 87 ms with this and 160 to 480 ms without. The first is read by
# GNU's runtime, the second by Intel's and LLVM's, both when torch is first imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("KMP_BLOCKTIME", "0")


def recover(options: RecoverOptions, settings: Preset | None = None) -> dict[str, Any]:
    """Recover the albedo texture into `options.out`, in this process; returns what report.json holds.

    Args:
        options: what the command line offers, with `out`.
        settings: numbers of both models, in place of those of the preset; see `presets.PRESETS`.

    Raises:
        DanteError: what the command ends with, see `contract.errors`; a former result stays as it was.
    """
    from dante_w.commands.recover import recover_and_publish

    return recover_and_publish(options, settings)
