"""An encoder layer in training's library in C (`native/training/encoder_layer.c`), for PyTorch's autograd.

Source: Eq. 3–5; the layer and its gradients in float32 equal PyTorch's to rounding (`tests/test_training_kernel.py`).
"""

from collections.abc import Sequence
from ctypes import Structure, byref, c_float, c_int, c_void_p
from typing import Any

import torch
from torch import Tensor

from foten.training.dropout import factors
from foten.training.training_kernel import PADDED, fields, padded, run_in_c

_WEIGHTS = (
    "norm_1_weight norm_1_bias in_weight in_bias out_weight out_bias "
    "norm_2_weight norm_2_bias feed_in_weight feed_in_bias feed_out_weight feed_out_bias"
)
LARGEST_GROUP = 20  # windows, of which the way back is not needed
_SAVED = "normed_1 inverse_sd_1 projected shares mixed normed_2 inverse_sd_2 fed"


class EncoderLayer(Structure):
    """encoder_layer."""

    _fields_ = fields(
        counts=("b n n_queries width n_heads n_fed share_stride keeps", c_int),
        inputs=(f"tokens {_WEIGHTS} bits", c_void_p),
        least=("least_kept", c_int),
        factor=("kept_factor", c_float),
        outputs=(f"encoded {_SAVED}", c_void_p),
    )


class EncoderGradients(Structure):
    """encoder_gradients."""

    _fields_ = fields(arrays=(f"by_encoded by_tokens {_WEIGHTS}", c_void_p))


def has_kernel(tokens: Tensor, n_fed: int) -> bool:
    """Whether tokens (b, n, width) go through a layer in C: in float32 on the CPU, of widths that fill its vectors."""
    if tokens.device.type != "cpu" or tokens.dtype != torch.float32 or torch.onnx.is_in_onnx_export():
        return False
    return tokens.shape[2] % PADDED == 0 and n_fed % PADDED == 0


def encoded(
    tokens: Tensor, weights: Sequence[Tensor], bits: Tensor | None, p: float, n_heads: int, last_only: bool
) -> Tensor:
    """Encoded tokens, with a gradient: (b, n, width) → (b, n, width), or the last of them alone, (b, 1, width).

    Args:
        weights: weight and bias of the first normalisation, of queries, keys and values, of what attention mixes, of the second
            normalisation, of the hidden layer and of what it gives.
        bits: `dropout.random_bits` of all that attention mixes, of the hidden layer and of what it gives; None for no dropout.
        p: share that is dropped.
    """
    n_queries, keeps = 1 if last_only else tokens.shape[1], torch.is_grad_enabled()
    out: Tensor = _Encoded.apply(tokens, n_heads, n_queries, keeps, bits, p, *weights)
    return out


class _Encoded(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        tokens: Tensor,
        n_heads: int,
        n_queries: int,
        keeps: bool,
        bits: Tensor | None,
        p: float,
        *weights: Tensor,
    ) -> Tensor:
        tokens = tokens.contiguous()
        b, n, width = tokens.shape
        n_fed, stride = weights[8].shape[0], padded(n_queries)
        of_window = [n * width, n, n * 3 * width, n_heads * n * stride]
        of_window += [n_queries * width, n_queries * width, n_queries, n_queries * n_fed]
        # One block, whose parts are read up to a vector after their ends.
        sizes = [(b if keeps else min(b, LARGEST_GROUP)) * size + PADDED for size in of_window]
        out, block = torch.empty(b, n_queries, width), torch.empty(sum(sizes))
        places = [block.data_ptr() + 4 * sum(sizes[:k]) for k in range(len(sizes))]
        counts = b, n, n_queries, width, n_heads, n_fed, stride, keeps
        inputs = (tokens, *weights, bits)
        pointers = (None if array is None else array.data_ptr() for array in inputs)
        layer = EncoderLayer(*counts, *pointers, *factors(p), out.data_ptr(), *places)
        run_in_c("foten_train_encoder", byref(layer))
        # What the layer points to, but for `out`, which would hold itself.
        ctx.layer, ctx.kept = layer, (inputs, block)
        return out

    @staticmethod
    def backward(ctx: Any, *by_outputs: Tensor) -> tuple[Any, ...]:
        (by_encoded,) = (by_output.contiguous() for by_output in by_outputs)
        (tokens, *weights, _), _ = ctx.kept
        by_tokens, by_weights = torch.empty_like(tokens), [torch.zeros_like(weight) for weight in weights]
        arrays = (by_encoded, by_tokens, *by_weights)
        run_in_c("foten_train_encoder_back", byref(ctx.layer), byref(EncoderGradients(*(a.data_ptr() for a in arrays))))
        return by_tokens, None, None, None, None, None, *by_weights
