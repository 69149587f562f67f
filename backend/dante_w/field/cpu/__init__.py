"""The paper's model on the CPU, in numba: whole steps of the fit, and values without gradients."""
