"""The paper's model on CUDA, in Triton: steps of the fit, and encodings without gradients.

Experimental: no run on a GPU is recorded yet. The tests run the kernels in Triton's interpreter and compile them for NVIDIA
GPUs of compute capability 8.0 and 9.0. Without Triton, or where it fails, a GPU computes in plain torch.
"""
