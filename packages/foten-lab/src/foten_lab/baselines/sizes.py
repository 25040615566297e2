"""Networks that ONNX Runtime runs: variants of the paper's (Table II), and systems compared with it (Tables I, III).

Sizes that a source does not state are our choice.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

from foten.models.foten.sizes import SpectralSizes, TransformerSizes
from foten.models.model_sizes import ModelSizes, check_heads
from foten.models.registry import MAX_GRAPH_WINDOW, GraphSizes
from foten.training.config import LoopConfig, Trainable, window_recipes


@dataclass(frozen=True)
class TenMfccSizes(TransformerSizes, GraphSizes):
    """TEN with cepstral coefficients of the window in place of the Fourier branch, Table II: our reading of "TEN-MFCC"."""

    window: int = 30  # m, samples; Table II
    n_bands: int = 12  # of the triangular filters, spaced as mel are; the paper is silent
    n_coefficients: int = 8  # kept of their cosine transform; the paper is silent
    spectral_width: int = 32  # that coefficients are lifted to for an encoder layer, as FoTEN's
    n_branches: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        check_heads(self.spectral_width, self.n_heads)
        if self.n_coefficients > self.n_bands:
            raise ValueError(f"n_coefficients is {self.n_coefficients}, expected at most n_bands, {self.n_bands}")


@dataclass(frozen=True)
class TenWaveletSizes(TransformerSizes, GraphSizes):
    """TEN with wavelet coefficients of the window in place of the Fourier branch, Table II: our reading of "TEN-Wavelet"."""

    window: int = 30  # m, samples; Table II
    n_levels: int = 3  # of Daubechies' wavelet with two vanishing moments; the paper is silent
    spectral_width: int = 32  # that coefficients are lifted to for an encoder layer, as FoTEN's
    n_branches: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        check_heads(self.spectral_width, self.n_heads)
        _check_window(self.window, 2 ** (self.n_levels + 1), f"{self.n_levels} levels")


@dataclass(frozen=True)
class FotenDSizes(SpectralSizes, GraphSizes):
    """FoTEN with a decoder layer of one query token in place of the last token, Table II: our reading of "FoTEN-D"."""


@dataclass(frozen=True)
class FnnSizes(GraphSizes):
    """Band by band [13]: a small network for each of four bands."""

    window: int = 144  # the longest lag, and the filters' memory before it
    n_lags: int = 10  # of each band, 8, 4, 2 and 1 samples apart from the lowest band on
    first: int = 20  # hidden units
    second: int = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_window(self.window, 8 * self.n_lags + 16, f"{self.n_lags} lags of 8 samples")


@dataclass(frozen=True)
class DstnSizes(GraphSizes):
    """Deep spatio-temporal network [15]: convolutions, attention over channels and time, and recurrent layers."""

    window: int = 40  # m, samples; Table III
    channels: int = 64
    squeezed: int = 8  # channels of the attention's bottleneck
    recurrent: int = 64  # each way
    dense: int = 64


@dataclass(frozen=True)
class HapinfSizes(GraphSizes):
    """Encoder and decoder after Informer, here the teacher of LDHTD [20]; no source of it was available."""

    window: int = 20  # m, samples
    d_model: int = 64
    n_heads: int = 4
    n_layers: int = 2  # of the encoder; the decoder has one
    d_feedforward: int = 256
    n_start: int = 10  # samples that the decoder begins with

    def __post_init__(self) -> None:
        super().__post_init__()
        check_heads(self.d_model, self.n_heads)
        if self.n_start > self.window:
            raise ValueError(f"n_start is {self.n_start}, expected at most the window, {self.window}")


@dataclass(frozen=True)
class LdhtdSizes(GraphSizes):
    """Recurrent encoder of speed and force, attending decoder of acceleration [20], distilled from `hapinf`."""

    window: int = 20  # m, samples; Table III
    recurrent: int = 32
    d_model: int = 32
    n_heads: int = 4
    d_feedforward: int = 128
    dense: int = 64

    def __post_init__(self) -> None:
        super().__post_init__()
        check_heads(self.d_model, self.n_heads)


@dataclass(frozen=True)
class NoiseModelSizes(ModelSizes):
    """Sizes of a model of spectra, whose graph filters noise and takes it in place of the acceleration."""

    max_window: ClassVar[int] = MAX_GRAPH_WINDOW
    predicts_samples: ClassVar[bool] = False


@dataclass(frozen=True)
class DftnetSizes(NoiseModelSizes):
    """Spectra of short frames from past speed and force, played as filtered noise [14]."""

    window: int = 100  # samples of a frame, and of the condition before it
    n_conditions: int = 10  # speeds and forces of these that it is given
    first: int = 256  # hidden units
    second: int = 256
    third: int = 128

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_window(self.window, max(8, self.n_conditions), f"{self.n_conditions} conditions")


@dataclass(frozen=True)
class GanSizes(NoiseModelSizes):
    """A generator of spectra from noise, speed and force, played as filtered noise [34]."""

    window: int = 272  # samples: 27 frames, the receptive field of three layers
    frame: int = 64  # samples
    stride: int = 8  # samples from one frame to the next
    channels: int = 48

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frame < 8:
            raise ValueError(f"frame is {self.frame}, expected 8 or more")
        if self.frame % self.stride:
            raise ValueError(f"frame is {self.frame}, expected a multiple of stride, {self.stride}")
        n = 26 * self.stride + self.frame
        if self.window != n:
            frames = f"27 frames of {self.frame} samples, {self.stride} apart"
            raise ValueError(f"window is {self.window}, expected {n}: {frames}")


def _check_window(window: int, minimum: int, purpose: str) -> None:
    if window < minimum:
        raise ValueError(f"window is {window}, expected {minimum} or more for {purpose}")


def _of_windows(sizes: type[ModelSizes], fit: str = "fit_one_step", **own: Any) -> Trainable:
    return Trainable(sizes, window_recipes(**own), f"foten_lab.baselines.fit:{fit}")


_SQUARED = {"loss": "mse", "optimiser": "adamw"}  # our choice; losses of the variants of TEN are those of Sec. VI-d
BASELINES: dict[str, Trainable] = {
    "ten-mfcc": _of_windows(TenMfccSizes),
    "ten-wavelet": _of_windows(TenWaveletSizes, loss="mse"),
    "foten-d": _of_windows(FotenDSizes),
    "fnn": _of_windows(FnnSizes, **_SQUARED),
    "dstn": _of_windows(DstnSizes, **_SQUARED),
    "hapinf": _of_windows(HapinfSizes, **_SQUARED),
    "ldhtd": _of_windows(LdhtdSizes, "fit_distilled", **_SQUARED),
    "dftnet": _of_windows(DftnetSizes, "fit_spectra", **_SQUARED),
    "gan": Trainable(
        GanSizes,
        # Epochs are of 50 steps, not of all windows.
        {"default": LoopConfig(epochs=60, patience=60, batch=64, learning_rate=2e-4)},
        "foten_lab.baselines.fit:fit_generator",
    ),
}
