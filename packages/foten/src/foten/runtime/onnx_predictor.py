"""Networks that the kernel has no code for, as graphs in ONNX Runtime."""

import functools
import re
import threading
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.models.excitation import Excitation
from foten.models.model_sizes import ModelSizes
from foten.models.registry import GRAPH
from foten.models.stream import Model
from foten.models.texture_file import Texture
from foten.models.window_model import NoiseModel, WindowModel
from foten.untrusted import brief

INPUT, NOISE, OUTPUT = "windows", "noise", "next"
MAX_BYTES = 1 << 28  # of the samples in all graphs
MAX_RUN_S, MAX_WAIT_S = 0.1, 2.0  # processor time of two windows, of which foten's take 2 ms; until a run is stopped
FOLDING = ["ConstantFolding"]  # work of a graph without input, which no bound holds for; there is little in foten's
# Of our networks. A file is not trusted: no operator that loops, branches, reads files or is defined elsewhere.
_OPERATORS = re.compile(
    "Add|And|Atan|Cast|Clip|Concat|Constant|ConstantOfShape|Conv|Cos|Div|Einsum|Equal|Exp|Flatten|Gather|Gemm|Greater|Identity|LSTM|"
    "LayerNormalization|Less|Log|MatMul|Mul|Pow|ReduceMean|ReduceSum|Relu|Reshape|Shape|Sigmoid|Sin|Slice|Softmax|Sqrt|Squeeze|"
    "Sub|Tanh|Transpose|Unsqueeze|Where"
)


class OnnxPredictor:
    """Network in ONNX Runtime, on one thread, in float32: windows (b, m, 3) → (b,); ValueError where it is missing, or damaged.

    A graph takes acceleration, speed and force, or, where its input is `NOISE`, noise in place of acceleration.
    """

    def __init__(self, sizes: ModelSizes, tensors: Mapping[str, NDArray[Any]]) -> None:
        self.window = sizes.history
        self._session = _session(tensors[GRAPH].tobytes())
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        self._input = inputs[0].name
        named = [(value.name, value.type) for value in (*inputs, *outputs)]
        expected = [(NOISE if self.takes_noise else INPUT, "tensor(float)"), (OUTPUT, "tensor(float)")]
        if named != expected or inputs[0].shape[1:] != [self.window, 3]:
            taken = [(value.name, value.shape) for value in inputs]
            raise ValueError(f"the graph takes {taken}, expected windows (b, {self.window}, 3)")
        shape = self._first_run().shape
        if shape != (2,):
            raise ValueError(f"the graph gives {shape} of two windows, expected (2,)")
        self._columns = [3, 1, 2] if self.takes_noise else [0, 1, 2]

    @property
    def takes_noise(self) -> bool:
        """Whether the graph makes samples from noise, and predicts none."""
        return str(self._input) == NOISE

    def _first_run(self) -> Array:
        """Next samples of two windows of zeros; ValueError where a graph that is not trusted takes too much for them."""
        from onnxruntime import RunOptions

        options, began_s = RunOptions(), time.thread_time()
        (stop := threading.Timer(MAX_WAIT_S, setattr, (options, "terminate", True))).start()
        try:
            following = self._run(np.zeros((2, self.window, 3), dtype=np.float32), options)
        finally:
            stop.cancel()
        if (took_s := time.thread_time() - began_s) > MAX_RUN_S:
            raise ValueError(f"the texture's graph takes {took_s:.2g} s for two windows, expected {MAX_RUN_S:g}")
        return following

    def _run(self, windows: NDArray[np.float32], options: Any = None) -> Array:
        try:
            return np.asarray(self._session.run([OUTPUT], {self._input: windows}, options)[0], dtype=np.float64)
        except Exception as error:  # of onnxruntime, whose errors have no common base but this
            raise ValueError(f"the texture's graph does not run within its bounds: {brief(error)}") from error

    def predict(self, windows: Array) -> Array:
        """Next samples, scaled, (b,), of windows (b, m, 3) of what the graph takes."""
        return self._run(windows.astype(np.float32))

    def next_sample(self, window: NDArray[np.float32]) -> float:
        """Next sample, scaled, of the kernel's window (1, m, 4): acceleration, speed, force, noise."""
        return float(self._run(window[:, :, self._columns])[0])


def _session(graph: bytes) -> Any:
    try:
        import onnx
        import onnxruntime
    except ImportError as error:
        raise ValueError(
            "a graph runs in ONNX Runtime, which is missing: pip install './packages/foten[onnx]'"
        ) from error
    try:
        model = onnx.load_from_string(graph)
    except Exception as error:  # protobuf's, whichever of its implementations is installed
        raise ValueError("the texture's graph is damaged: it is no ONNX") from error
    foreign = {node.op_type for node in model.graph.node if node.domain or not _OPERATORS.fullmatch(node.op_type)}
    if foreign or model.functions or any(tensor.data_location for tensor in model.graph.initializer):
        what = f"operator {min(foreign)}" if foreign else "part"
        raise ValueError(f"the texture's graph has a foreign {what}, and is not run: none of foten's networks has it")
    try:
        return onnxruntime.InferenceSession(graph, _options(), ["CPUExecutionProvider"], disabled_optimizers=FOLDING)
    except Exception as error:
        raise ValueError(f"the texture's graph is damaged: {brief(error)}") from error


@functools.cache
def _options() -> Any:
    """Options of all sessions, which share a thread's worth of work and `MAX_BYTES`."""
    import onnxruntime as ort

    place = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    ort.create_and_register_allocator(place, ort.OrtArenaCfg({"max_mem": MAX_BYTES}))
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # the error says what is wrong
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.use_env_allocators", "1")
    return options


def model_of_graph(texture: Texture) -> Model:
    """The model of a texture's graph, run by ONNX Runtime."""
    predictor = OnnxPredictor(texture.sizes, texture.tensors)
    if predictor.takes_noise:
        return NoiseModel(predictor.predict, predictor.window)
    excitation = Excitation.of(texture.tensors) if texture.sizes.excited else None
    return WindowModel(predictor.predict, predictor.window, excitation)
