"""A training that gives the same numbers each time."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def reproducible() -> Iterator[None]:
    """Deterministic algorithms, and one thread for PyTorch's own operations; `shared_gradients` shares out the batch."""
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # a fixed order of sums on a GPU
    n_threads, deterministic = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(1)
    # On the CPU one thread adds up in one order anyway, and the call takes a second, for it loads a compiler.
    on_gpu = torch.cuda.is_available()
    if on_gpu:
        torch.use_deterministic_algorithms(True, warn_only=True)
    try:
        yield
    finally:
        torch.set_num_threads(n_threads)
        if on_gpu:
            torch.use_deterministic_algorithms(deterministic)
