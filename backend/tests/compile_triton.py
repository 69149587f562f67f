"""Compile the kernels of `cuda.kernels` for an NVIDIA GPU of the given capability, down to machine code; none is needed."""

from __future__ import annotations

import sys

import triton
from dante_w.field.cuda import kernels
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource

TYPES = {
    "levels": "*i64",
    "count": "i32",
    "first_level": "i32",
    "columns": "i32",
    "seed": "i32",
    "rate": "fp32",
    "root": "fp32",
}
TYPES |= {"mean": "*bf16", "square": "*bf16"}
CONSTANTS = {"dimensions": 3, "features": 2, "width": 2, "block": 128}

for name in ("encode_kernel", "scatter_kernel", "adam_kernel"):
    kernel = getattr(kernels, name)
    types = {n: "constexpr" if n in CONSTANTS else TYPES.get(n, "*fp32") for n in kernel.arg_names}
    constants = {(i,): CONSTANTS[n] for i, n in enumerate(kernel.arg_names) if n in CONSTANTS}
    compiled = triton.compile(ASTSource(kernel, types, constants), GPUTarget("cuda", int(sys.argv[1]), 32))
    if compiled.asm["cubin"]:
        print(name)
