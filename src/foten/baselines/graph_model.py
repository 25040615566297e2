"""The definition of a model whose file holds a graph: what the graph predicts, or what it makes of noise."""

from foten.models.excitation import Excitation
from foten.models.stream import Model
from foten.models.texture_file import Texture
from foten.models.window_model import NoiseModel, WindowModel
from foten.runtime.onnx_predictor import OnnxPredictor


def model_of_graph(texture: Texture) -> Model:
    """The model of a texture's graph, run by ONNX Runtime."""
    predictor = OnnxPredictor(texture.sizes, texture.tensors)
    if predictor.takes_noise:
        return NoiseModel(predictor.predict, predictor.window)
    excitation = Excitation.of(texture.tensors) if texture.sizes.excited else None
    return WindowModel(predictor.predict, predictor.window, excitation)
