"""Networks as graphs, run by ONNX Runtime: what the kernel has no code for."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.families.sizes import Sizes

GRAPH = "graph"  # the tensor that holds one, as bytes
INPUT, OUTPUT = "windows", "next"
# What our networks are made of. A file is not trusted: nothing that repeats, branches, reads other files or is somebody's own.
_OPERATORS = re.compile(
    "Add|And|Atan|Cast|Clip|Concat|Constant|ConstantOfShape|Conv|Cos|Div|Einsum|Equal|Exp|Flatten|Gather|Gemm|Greater|Identity|LSTM|"
    "LayerNormalization|Less|Log|MatMul|Mul|Pow|ReduceMean|ReduceSum|Relu|Reshape|Shape|Sigmoid|Sin|Slice|Softmax|Sqrt|Squeeze|"
    "Sub|Tanh|Transpose|Unsqueeze|Where"
)


class OnnxPredictor:
    """A network in ONNX Runtime, on one thread, in float32: windows (b, m, 3) → (b,), or (b, n_ahead) where n_ahead > 1.

    Raises:
        ValueError: onnxruntime is not installed, or the graph is damaged or another one.
    """

    def __init__(self, sizes: Sizes, tensors: Mapping[str, NDArray[Any]]) -> None:
        self.window, self.n_ahead = sizes.history, sizes.n_ahead
        self._session = _session(tensors[GRAPH].tobytes())
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        named = [(one.name, one.type) for one in (*inputs, *outputs)]
        if named != [(INPUT, "tensor(float)"), (OUTPUT, "tensor(float)")] or inputs[0].shape[1:] != [self.window, 3]:
            taken = [(one.name, one.shape) for one in inputs]
            raise ValueError(f"the graph takes {taken}, expected windows (b, {self.window}, 3)")
        shape = self._session.run([OUTPUT], {INPUT: np.zeros((2, self.window, 3), dtype=np.float32)})[0].shape
        expected = (2,) if self.n_ahead == 1 else (2, self.n_ahead)
        if shape != expected:
            raise ValueError(f"the graph gives {shape} of two windows, expected {expected}")

    def ahead(self, windows: Array) -> Array:
        """Samples to come: windows (b, m, 3) scaled → (b, n_ahead) scaled."""
        (following,) = self._session.run([OUTPUT], {INPUT: windows.astype(np.float32)})
        return np.asarray(following, dtype=np.float64).reshape(-1, self.n_ahead)

    def predict_into(self, window: NDArray[np.float32], out: NDArray[np.float32]) -> None:
        """Fill in the samples to come, (n_ahead,) scaled, of a window (1, m, 3) scaled.

        Raises:
            ValueError: there is room for another number of them.
        """
        if out.shape != (self.n_ahead,):
            raise ValueError(f"the card speaks of {out.size} samples at once, and the graph of {self.n_ahead}")
        out[:] = self._session.run([OUTPUT], {INPUT: window})[0].ravel()


def _session(graph: bytes) -> Any:
    try:
        import onnx
        import onnxruntime
    except ImportError as error:
        missing = "this texture's model runs in ONNX Runtime, which is not installed"
        raise ValueError(f"{missing}: pip install 'foten[onnx]'") from error
    try:
        model = onnx.load_from_string(graph)
    except Exception as error:  # protobuf's, whichever of its implementations is installed
        raise ValueError("the texture's graph is damaged: it is no ONNX") from error
    foreign = {node.op_type for node in model.graph.node if node.domain or not _OPERATORS.fullmatch(node.op_type)}
    if foreign or model.functions or any(one.data_location for one in model.graph.initializer):
        what = f"operator {min(foreign)}" if foreign else "part"
        raise ValueError(f"the texture's graph has a foreign {what}, and is not run: none of foten's networks has it")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what is wrong is said by the error
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # of onnxruntime, whose errors have no common base but this
        raise ValueError(f"the texture's graph is damaged: {str(error).splitlines()[0][:200]}") from error
