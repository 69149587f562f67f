"""The model on the CPU: numba kernels that take samples in blocks, one row per feature and one column per sample.

A block's matrices stay in the processor's cache, and loops over its columns become SIMD instructions.
"""

#: Samples in a block.
BLOCK = 128
