"""Initial weights as Keras draws them, in which the paper trained: Glorot's."""

import math

import torch
from torch import Tensor, nn

PROJECTIONS = ("attention_in", "query_in", "memory_in")  # of attention: queries, keys and values
JOINED = ("attention_out", "memory_out")  # what joins its heads


@torch.no_grad()
def draw_glorot(network: nn.Module) -> None:
    """Draw a network's weights anew, as Keras 2.8 does by default.

    A kernel is uniform within √(6 / (inputs + outputs)) (Glorot and Bengio, AISTATS 2010), biases are zero, what goes from state
    to state in a recurrent layer is orthogonal, and an LSTM's forget gate begins open. Keras counts the inputs and outputs of a
    kernel of more than two axes as a convolution's: (width, heads, width of a head) of queries, keys and values, and (heads,
    width of a head, width) of what joins the heads.
    """
    for module in network.modules():
        if isinstance(module, nn.Linear):
            _uniform(module.weight, sum(module.weight.shape))
            _zero(module.bias)
        elif isinstance(module, nn.Conv1d):
            _uniform(module.weight, sum(module.weight.shape[:2]) * module.weight.shape[2])
            _zero(module.bias)
        elif isinstance(module, nn.RNNBase):
            _draw_recurrent(module)
    for module in network.modules():  # after the linear maps that they are made of
        if isinstance(heads := getattr(module, "n_heads", None), int):
            for name, kernel in module.named_parameters(recurse=True):
                layer, _, of = name.partition(".")
                if of == "weight" and layer in PROJECTIONS:
                    width = kernel.shape[1]
                    _uniform(kernel, width * (heads + width // heads))
                elif of == "weight" and layer in JOINED:
                    width = kernel.shape[1]
                    _uniform(kernel, width + heads * kernel.shape[0])


def _draw_recurrent(module: nn.RNNBase) -> None:
    units = module.hidden_size
    for name, parameter in module.named_parameters():
        if name.startswith("weight_ih"):
            _uniform(parameter, sum(parameter.shape))
        elif name.startswith("weight_hh"):
            parameter.copy_(nn.init.orthogonal_(torch.empty(parameter.shape)))
        else:
            parameter.zero_()
            if isinstance(module, nn.LSTM) and name.startswith("bias_ih"):  # gates: in, forget, cell, out
                parameter[units : 2 * units] = 1.0


def _uniform(kernel: Tensor, inputs_and_outputs: int) -> None:
    limit = math.sqrt(6 / inputs_and_outputs)
    kernel.copy_(torch.empty(kernel.shape).uniform_(-limit, limit))  # drawn on the CPU: the same on any device


def _zero(bias: Tensor | None) -> None:
    if bias is not None:
        bias.zero_()
