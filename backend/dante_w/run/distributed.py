"""Several processes at one fit, as `torchrun` starts them: each draws from photos of its own, all take the mean gradient.

So all hold the same model after every step. The first process alone speaks and writes. If another one fails, it tells
the first, which says so and ends with that exit code. Started in any other way, a process is alone and nothing here does anything.
"""

from __future__ import annotations

import json
import os
import sys
import time
from datetime import timedelta
from functools import cache
from typing import TYPE_CHECKING, Any

from dante_w.contract.errors import DanteError

if TYPE_CHECKING:
    import numpy as np
    import torch

_FAILURE, _HEARD = "dante_w/failure", "dante_w/heard"
#: Seconds that a process which failed waits for the first one to say so, before `torchrun` ends them all.
PATIENCE = 5.0
#: Between the seeds of neighbouring processes.
SEEDS = 7919


class Elsewhere(DanteError):
    """Another process failed, with this exit code and sentence."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.exit_code = code


def world() -> int:
    """How many processes there are."""
    return int(os.environ["WORLD_SIZE"]) if "TORCHELASTIC_RUN_ID" in os.environ else 1


def rank() -> int:
    """This process's number, 0 for the first."""
    return int(os.environ["RANK"]) if world() > 1 else 0


def join(device: torch.device) -> None:
    """Meet the others. A process takes the GPU of its number on its machine, or its share of the threads."""
    if world() == 1:
        return
    import numba
    import torch
    import torch.distributed as together

    numba.set_num_threads(max(numba.get_num_threads() // int(os.environ["LOCAL_WORLD_SIZE"]), 1))
    if device.type == "cuda":
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]) % torch.cuda.device_count())
    if not together.is_initialized():
        together.init_process_group("cpu:gloo,cuda:nccl" if device.type == "cuda" else "gloo")


def mean(tensor: torch.Tensor) -> None:
    """Replace a tensor by its mean over all processes, in place; every process gets the same bytes."""
    if world() > 1:
        import torch.distributed as together

        together.all_reduce(tensor)
        tensor /= world()


def own(ranges: np.ndarray) -> np.ndarray:
    """Of ranges of samples (R, 2), one per photo, those of this process; all, if there are fewer than processes."""
    return ranges[rank() :: world()] if len(ranges) >= world() else ranges


def tell(code: int, message: str) -> None:
    """Let the first process know why this one ends."""
    if rank() == 0:
        return
    try:
        store = _store()
        store.set(_FAILURE, json.dumps([code, message]))
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until and not store.check([_HEARD]):
            time.sleep(0.05)
    except RuntimeError:  # the first process, or torchrun, is gone
        pass


def check() -> None:
    """Raises what another process failed with; only the first one is told.

    Raises:
        Elsewhere: one has failed.
    """
    if world() == 1 or rank() > 0 or "torch.distributed" not in sys.modules:
        return  # loading it takes seconds, and signals come first
    try:
        store = _store()
        if not store.check([_FAILURE]):
            return
        code, message = json.loads(store.get(_FAILURE))
        store.set(_HEARD, "")
    except RuntimeError:
        return
    raise Elsewhere(code, message)


def cause(error: BaseException) -> BaseException:
    """Why the first process really failed with `error`: perhaps another one is gone, and will say so in a moment."""
    first = world() > 1 and rank() == 0
    until = time.monotonic() + PATIENCE
    while first and not isinstance(error, DanteError) and time.monotonic() < until:
        try:
            check()
        except Elsewhere as elsewhere:
            return elsewhere
        time.sleep(0.05)
    return error


@cache
def _store() -> Any:
    """What `torchrun` keeps for its processes; a connection of its own, for others may be waiting on theirs."""
    from torch.distributed import TCPStore

    address, port = os.environ["MASTER_ADDR"], int(os.environ["MASTER_PORT"])
    return TCPStore(address, port, timeout=timedelta(seconds=PATIENCE))
