"""One step of the fit: its interface, and the reference in plain torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np
import torch

from dante_w.field.fields import FieldModel
from dante_w.field.loss import model_loss
from dante_w.field.terms import LossTerms
from dante_w.rays.ray_cache import Samples

#: Replaces a gradient by its mean over all processes, in place.
AllReduce = Callable[[torch.Tensor], None]


class Step(Protocol):
    """One way to compute a step of the fit, made from the model, the loss's terms, the parameters that may change, and the
    learning rate.

    `TorchStep` is plain torch, for any device, and the reference; `cpu.step.CpuStep` is numba; `cuda.step.CudaStep` is Triton.
    """

    def gradients(
        self, samples: Samples
    ) -> tuple[float | torch.Tensor, Mapping[str, np.ndarray | torch.Tensor]]:
        """Loss of a batch, and its gradients by parameter name; valid until `update`, which has to follow."""
        ...

    def update(self, rate: float, all_reduce: AllReduce | None = None) -> None:
        """Change the parameters by Adam, with the learning rate times `rate`, after `all_reduce`, if any, on each gradient."""
        ...


class TorchStep:
    """`Step` by autograd and `torch.optim.Adam`."""

    def __init__(
        self,
        model: FieldModel,
        terms: LossTerms,
        parameters: Sequence[torch.nn.Parameter],
        learning_rate: float,
    ) -> None:
        self._model, self._terms, self._learning_rate = model, terms, learning_rate
        chosen = {id(parameter) for parameter in parameters}
        self._parameters = {name: p for name, p in model.named_parameters() if id(p) in chosen}
        on_mps = model.offset.device.type == "mps"
        self._optimiser = torch.optim.Adam(
            self._parameters.values(), lr=learning_rate, eps=1e-15, fused=not on_mps
        )

    def gradients(self, samples: Samples) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """See `Step`; parameters that the loss does not depend on are left out."""
        loss = model_loss(self._model, samples, self._terms)
        gradients = torch.autograd.grad(loss, list(self._parameters.values()), allow_unused=True)
        for parameter, gradient in zip(self._parameters.values(), gradients, strict=True):
            parameter.grad = gradient
        return loss.detach(), {name: p.grad for name, p in self._parameters.items() if p.grad is not None}

    def update(self, rate: float, all_reduce: AllReduce | None = None) -> None:
        """See `Step`."""
        for parameter in self._parameters.values():
            if all_reduce and parameter.grad is not None:
                all_reduce(parameter.grad)
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate * rate
        self._optimiser.step()
        self._optimiser.zero_grad(set_to_none=True)
