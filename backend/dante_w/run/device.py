"""Which device to compute on, and how much memory there is."""

from __future__ import annotations

import sys

import psutil
import torch

from dante_w.contract.errors import BadInput


def pick_device(name: str) -> torch.device:
    """The device called auto, cpu, cuda or mps; auto takes a GPU only if it really computes.

    Raises:
        BadInput: the named device is not there or does not work.
    """
    if name == "auto":
        return next(
            (torch.device(gpu) for gpu in ("cuda", "mps") if failure(gpu) is None), torch.device("cpu")
        )
    reason = failure(name)
    if reason is not None:
        raise BadInput(f"--device {name} does not work here ({reason}); use --device cpu.")
    return torch.device(name)


def failure(name: str) -> str | None:
    """Why a device cannot be used, or None. A GPU newer than the torch build fails only when used."""
    if name == "cuda" and not torch.cuda.is_available():
        return "this torch finds no CUDA GPU"
    if name == "mps" and not torch.backends.mps.is_available():
        return "this torch finds no Apple GPU"
    try:
        values = torch.ones(8, 8, device=name)
        return None if float((values @ values).sum()) == 512.0 else "it computes wrong results"
    except RuntimeError as error:
        return str(error).strip().splitlines()[0]


def peak_memory() -> int:
    """Largest resident size of this process so far, in bytes."""
    if sys.platform == "win32":
        return int(psutil.Process().memory_info().peak_wset)
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
