"""Recover the diffuse albedo texture of a UV-mapped mesh from posed photos (DANTE-W).

`commands.recover.recover(options, settings=...)` is the whole work as a function; `options.RecoverOptions` and `presets.Preset`
are what it takes.

The package never imports bpy; `contract` needs nothing beyond numpy, so that the Blender add-on uses the very same modules.
"""

import os

__version__ = "0.1.0"

# Idle OpenMP threads must sleep, not spin: torch and numba take turns on the same cores, and so does Blender.
# Measured on two cores, a step of the fit takes 87 ms with this and 160 to 480 ms without. The first is read by
# GNU's runtime, the second by Intel's and LLVM's, both when torch is first imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("KMP_BLOCKTIME", "0")
