"""The sizes of the networks, free of any framework: training and rendering both read them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar

HIGHEST_LOCAL_ORDER = 40  # beyond it line spectral frequencies no longer give the filter in float64
LONGEST_WINDOW = 512  # samples that the kernel's networks see
LONGEST_GIVEN = 4096  # and that it gives a graph
HEAVIEST_TAIL = 0.25  # of h in z·exp(h z²/2), the excitation's tails; beyond it there is no fourth moment


@dataclass(frozen=True)
class TenArchitecture:
    """The paper's network without its Fourier branch, TEN in Table II: the temporal branch and the head.

    Differs from the paper where it is silent: layers normalise before attention (Fig. 3 shows it so).
    """

    window: int = 25  # m, samples; Table II
    d_model: int = 32  # Sec. IV-c
    n_heads: int = 4  # Sec. IV-c
    n_layers: int = 3  # temporal encoder layers; Sec. IV-c
    d_feedforward: int = 128  # Sec. IV-c
    head: tuple[int, int] = (256, 64)  # dense layers before the output; Sec. IV-e
    pre_norm: bool = True  # False normalises after each sub-layer, as [17]
    excitation: bool = False  # whether there is a random part, as that of foten-plus; the paper has none
    excitation_width: int = 16  # hidden units of log σ over speed and force, and of log levels
    in_graph: ClassVar[bool] = False  # whether a file holds it as a graph for ONNX Runtime
    of_noise: ClassVar[bool] = False  # whether it is given noise in the place of acceleration
    n_branches: ClassVar[int] = 1  # each of which gives the head d_model numbers

    def __post_init__(self) -> None:
        least = {"window": 2, "d_model": 1, "n_heads": 1, "n_layers": 1, "d_feedforward": 1}
        for name, minimum in least.items():
            _check_count(name, getattr(self, name), minimum)
        _check_window(self.window, LONGEST_GIVEN if self.in_graph else LONGEST_WINDOW)
        if not isinstance(self.head, list | tuple) or len(self.head) != 2:
            raise ValueError(f"head is {self.head!r}, expected the widths of two layers")
        for width in self.head:
            _check_count("head", width, 1)
        _check_excitation(self.excitation, self.excitation_width)
        _check_heads(self.d_model, self.n_heads)
        if not isinstance(self.pre_norm, bool):
            raise ValueError("pre_norm is true or false")
        object.__setattr__(self, "head", tuple(self.head))

    @property
    def history(self) -> int:
        """Return how many samples a prediction is given."""
        return self.window

    @property
    def n_inputs(self) -> int:
        """Return how many numbers of each sample the temporal branch sees: its acceleration."""
        return 1

    @property
    def modulated(self) -> bool:
        """Return whether speed and force scale and shift what the branches find."""
        return False

    @property
    def excited(self) -> bool:
        """Return whether there is a random part."""
        return self.excitation

    @property
    def n_ahead(self) -> int:
        """Return how many samples a window gives."""
        return 1

    @property
    def n_found(self) -> int:
        """Return how many numbers the branches give the head."""
        return self.n_branches * self.d_model


@dataclass(frozen=True)
class FotenArchitecture(TenArchitecture):
    """The paper's network, Sec. IV: a temporal and a Fourier branch, fused at the last token.

    Differs from the paper where it is silent: as `TenArchitecture`; the spectral branches are lifted from width 1 to
    `spectral_width` and projected back, since at the literal width 1 a layer normalisation outputs a constant and the branch
    carries nothing; all m bins are kept and Eq. 9 gives its real part.
    """

    window: int = 20  # m, samples; Sec. VI-b
    spectral_width: int = 32  # 1 is the literal reading, and degenerate
    bin_embedding: bool = False  # a learned vector for each bin; the paper has none (Sec. IV-d)
    phase_input: str = "angle"  # or "cos_sin"
    magnitude_input: str = "linear"  # or "log", log(1 + M)
    bins: str = "all"  # or "half": 0 … m/2 with a Hermitian inverse, so that a_spec is real by itself
    n_branches: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_count("spectral_width", self.spectral_width, 1)
        if self.spectral_width > 1 and self.spectral_width % self.n_heads:
            raise ValueError(f"width {self.spectral_width} does not divide into {self.n_heads} heads")
        known = {
            "phase_input": ("angle", "cos_sin"),
            "magnitude_input": ("linear", "log"),
            "bins": ("all", "half"),
        }
        for name, values in known.items():
            if getattr(self, name) not in values:
                raise ValueError(
                    f"{name} is {getattr(self, name)!r}, expected {values[0]!r} or {values[1]!r}"
                )
        if self.spectral_width == 1 and self.phase_input == "cos_sin":
            raise ValueError("phase_input 'cos_sin' has two numbers a bin and needs a spectral_width above 1")
        if not isinstance(self.bin_embedding, bool):
            raise ValueError("bin_embedding is true or false")

    @property
    def n_bins(self) -> int:
        """Return how many bins the spectral branch sees."""
        return self.window if self.bins == "all" else self.window // 2 + 1


@dataclass(frozen=True)
class FotenPlusArchitecture(FotenArchitecture):
    """Ours: the same two branches and head, on a lattice that follows speed and force, and an excitation that does.

    The network's output is a bounded correction of the lattice's prediction; beside each sample it sees the lattice's innovation.
    The lattice's sizes are found in training.
    """

    correction_limit: float = (
        3.0  # in standard deviations of the lattice's innovation; |correction| stays below it
    )
    # Where speed and force enter: the "head" alone, as the paper's, or also each of the "tokens", or as a "modulation" of what
    # both branches find. One-step validation error re the head alone: tokens 0.960 on a simulated mesh, 1.001 on a towel, on
    # grass and on wood; modulation 0.983 on the mesh.
    hand: str = "tokens"
    excitation: bool = True  # always
    network_heard: bool = True  # whether a rendering hears the network; one with tones never does
    order: int = 20  # p of the lattice, samples
    n_speed: int = 1  # its vertices over speed
    n_force: int = 1  # and over force
    level_drives: bool = False  # whether the level scales what drives the lattice, or what leaves it
    n_tones: int = (
        0  # multiples of the path's frequency; none for a surface that does not repeat, nor what follows
    )
    n_tone_speed: int = 1  # vertices of their amplitudes over speed
    n_tone_force: int = 1  # and over force
    rest_order: int = 1  # of the lattice of what tones leave
    n_rest_speed: int = 1  # its vertices over speed
    n_rest_force: int = 1  # and over force
    rest_level_drives: bool = False  # as level_drives

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.excitation:
            raise ValueError("foten-plus always has an excitation")
        for name in ("order", "n_speed", "n_force"):
            _check_count(name, getattr(self, name), 1)
        for name in ("n_tone_speed", "n_tone_force", "rest_order", "n_rest_speed", "n_rest_force"):
            _check_count(name, getattr(self, name), 1)
        _check_count("n_tones", self.n_tones, 0)
        if self.hand not in ("head", "tokens", "modulation"):
            raise ValueError(f"hand is {self.hand!r}, expected 'head', 'tokens' or 'modulation'")
        for name in ("network_heard", "level_drives", "rest_level_drives"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name} is {getattr(self, name)!r}, expected true or false")
        if type(self.correction_limit) not in (int, float) or not 0 < self.correction_limit < 1e6:
            raise ValueError(f"correction_limit is {self.correction_limit!r}, expected a positive number")

    @property
    def history(self) -> int:
        """Return how many samples a prediction is given: a window of innovations, the lattice's order before it, and one."""
        return self.window + max(self.order, self.rest_order) + 1

    @property
    def n_inputs(self) -> int:
        """Return how many numbers of each sample the temporal branch sees: acceleration and innovation, speed and force."""
        return 4 if self.hand == "tokens" else 2

    @property
    def modulated(self) -> bool:
        """Return whether speed and force scale and shift what both branches find."""
        return self.hand == "modulation"


@dataclass(frozen=True)
class ArArchitecture:
    """Piecewise AR [12]: local linear models scattered over speed and force, mixed between the three around a hand.

    Where `ma` is 0 each is an autoregression; Penn's texture toolkit has zeros as well.
    """

    order: int = 20  # p, of all models alike
    ma: int = 0  # q, of what the innovations go through before
    n_models: int = 3
    n_triangles: int = 1
    window: int = 21  # samples that a prediction is given; at least p + 1, and more to find the innovations before zeros
    in_graph: ClassVar[bool] = False
    of_noise: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for name, least in {"order": 1, "ma": 0, "n_models": 3, "n_triangles": 1}.items():
            _check_count(name, getattr(self, name), least)
        for name in ("order", "ma"):
            if getattr(self, name) > HIGHEST_LOCAL_ORDER:
                raise ValueError(f"{name} is {getattr(self, name)}, expected {HIGHEST_LOCAL_ORDER} at most")
        _check_count("window", self.window, self.order + 1)

    @property
    def history(self) -> int:
        """Return how many samples a prediction is given."""
        return self.window

    @property
    def excited(self) -> bool:
        """Return whether there is a random part."""
        return True


@dataclass(frozen=True)
class TenMfccArchitecture(TenArchitecture):
    """TEN with cepstral coefficients of the window in place of the Fourier branch, Table II: our reading of "TEN-MFCC"."""

    window: int = 30  # m, samples; Table II
    n_bands: int = 12  # of the triangular filters, spaced as mel are; the paper is silent
    n_coefficients: int = 8  # kept of their cosine transform; the paper is silent
    in_graph: ClassVar[bool] = True
    n_branches: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_count("n_bands", self.n_bands, 2)
        _check_count("n_coefficients", self.n_coefficients, 1)
        if self.n_coefficients > self.n_bands:
            raise ValueError(
                f"n_coefficients is {self.n_coefficients}, expected at most n_bands, {self.n_bands}"
            )


@dataclass(frozen=True)
class TenWaveletArchitecture(TenArchitecture):
    """TEN with wavelet coefficients of the window in place of the Fourier branch, Table II: our reading of "TEN-Wavelet"."""

    window: int = 30  # m, samples; Table II
    n_levels: int = 3  # of Daubechies' wavelet with two vanishing moments; the paper is silent
    in_graph: ClassVar[bool] = True
    n_branches: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_count("n_levels", self.n_levels, 1)
        if self.window < 2 ** (self.n_levels + 1):
            raise ValueError(
                f"window is {self.window}, expected {2 ** (self.n_levels + 1)} or more for {self.n_levels} levels"
            )


@dataclass(frozen=True)
class FotenDArchitecture(FotenArchitecture):
    """FoTEN with a decoder layer of one query token in place of the last token, FoTEN-D in Table II: our reading."""

    in_graph: ClassVar[bool] = True


@dataclass(frozen=True)
class GraphArchitecture:
    """A network of another system, re-implemented; what its source does not state is our choice."""

    window: int = 20  # m, samples
    in_graph: ClassVar[bool] = True
    of_noise: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for size in fields(self):
            if size.type == "int":
                _check_count(size.name, getattr(self, size.name), 2 if size.name == "window" else 1)
        _check_window(self.window, LONGEST_GIVEN)

    @property
    def history(self) -> int:
        """Return how many samples a prediction is given."""
        return self.window

    @property
    def excited(self) -> bool:
        """Return whether there is a random part as that of foten-plus."""
        return False

    @property
    def n_ahead(self) -> int:
        """Return how many samples a window gives."""
        return 1


@dataclass(frozen=True)
class PredictorArchitecture(GraphArchitecture):
    """One that predicts what comes after recorded samples."""

    excitation: bool = (
        False  # whether there is a random part, as that of foten-plus; none of the sources has one
    )
    excitation_width: int = 16  # hidden units of log σ over speed and force

    def __post_init__(self) -> None:
        _check_excitation(self.excitation, self.excitation_width)
        super().__post_init__()

    @property
    def excited(self) -> bool:
        """Return whether there is a random part."""
        return self.excitation


@dataclass(frozen=True)
class FnnArchitecture(PredictorArchitecture):
    """Band by band [13]: a small network for each of four bands."""

    window: int = 144  # the longest lag, and the filters' memory before it
    n_lags: int = 10  # of each band, 8, 4, 2 and 1 samples apart from the lowest band on
    first: int = 20  # hidden units
    second: int = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.window < 8 * self.n_lags + 16:
            raise ValueError(
                f"window is {self.window}, expected {8 * self.n_lags + 16} or more for {self.n_lags} lags of 8 samples"
            )


@dataclass(frozen=True)
class DstnArchitecture(PredictorArchitecture):
    """Deep spatio-temporal network [15]: convolutions, attention over channels and time, and recurrent layers."""

    window: int = 40  # m, samples; Table III
    channels: int = 64
    squeezed: int = 8  # channels of the attention's bottleneck
    recurrent: int = 64  # each way
    dense: int = 64


@dataclass(frozen=True)
class HapinfArchitecture(PredictorArchitecture):
    """Encoder and decoder after Informer, the teacher of [20]; no source of it was found."""

    window: int = 20  # m, samples
    d_model: int = 64
    n_heads: int = 4
    n_layers: int = 2  # of the encoder; the decoder has one
    d_feedforward: int = 256
    n_start: int = 10  # samples that the decoder begins with

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_heads(self.d_model, self.n_heads)
        if self.n_start > self.window:
            raise ValueError(f"n_start is {self.n_start}, expected at most the window, {self.window}")


@dataclass(frozen=True)
class LdhtdArchitecture(PredictorArchitecture):
    """Recurrent encoder of speed and force, attending decoder of acceleration [20], distilled from `hapinf`."""

    window: int = 20  # m, samples; Table III
    recurrent: int = 32
    d_model: int = 32
    n_heads: int = 4
    d_feedforward: int = 128
    dense: int = 64

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_heads(self.d_model, self.n_heads)


@dataclass(frozen=True)
class LdhtdHopArchitecture(PredictorArchitecture):
    """What the authors of [20] published as code, without its images: a hop of samples at once from 200 before it."""

    window: int = 200  # samples of acceleration
    hop: int = 20  # samples of what is predicted, and of the hand that it goes by
    recurrent: int = 20
    found: int = 64  # of the hand
    d_model: int = 128
    n_heads: int = 4
    d_feedforward: int = 128

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_heads(self.d_model, self.n_heads)
        if self.hop > self.window:
            raise ValueError(f"hop is {self.hop}, expected at most the window, {self.window}")

    @property
    def n_ahead(self) -> int:
        """Return how many samples a window gives."""
        return self.hop


@dataclass(frozen=True)
class DftnetArchitecture(GraphArchitecture):
    """Spectra of short frames from what the hand did [14], given back as filtered noise."""

    window: int = 100  # samples of a frame, and of the hand before it
    n_told: int = 10  # speeds and forces that it is told of these
    first: int = 256  # hidden units
    second: int = 256
    third: int = 128
    of_noise: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.window < max(8, self.n_told):
            raise ValueError(
                f"window is {self.window}, expected {max(8, self.n_told)} or more for {self.n_told} speeds and forces"
            )


@dataclass(frozen=True)
class GanArchitecture(GraphArchitecture):
    """A generator of spectra from noise, speed and force [34], given back as filtered noise."""

    window: int = 272  # samples: 27 frames, which three layers look at
    frame: int = 64  # samples
    stride: int = 8  # samples from one frame to the next
    channels: int = 48
    of_noise: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frame < 8:
            raise ValueError(f"frame is {self.frame}, expected 8 or more")
        if self.frame % self.stride:
            raise ValueError(f"frame is {self.frame}, expected a multiple of stride, {self.stride}")
        if self.window != 26 * self.stride + self.frame:
            raise ValueError(
                f"window is {self.window}, expected {26 * self.stride + self.frame}: 27 frames of {self.frame} samples, "
                f"{self.stride} apart"
            )


Architecture = TenArchitecture | ArArchitecture | GraphArchitecture


def _check_excitation(excitation: object, width: object) -> None:
    if not isinstance(excitation, bool):
        raise ValueError(f"excitation is {excitation!r}, expected true or false")
    _check_count("excitation_width", width, 1)


def _check_window(window: int, longest: int) -> None:
    if window > longest:
        raise ValueError(
            f"window is {window}, expected at most {longest} samples: no longer ones are rendered"
        )


def _check_heads(width: int, n_heads: int) -> None:
    if width % n_heads:
        raise ValueError(f"width {width} does not divide into {n_heads} heads")


def _check_count(name: str, value: object, minimum: int) -> None:
    # 65536 bounds what a damaged file can make a program allocate.
    if type(value) is not int or not minimum <= value <= 65536:
        raise ValueError(f"{name} is {value!r}, expected a whole number, {minimum} or more")


NETWORKS: dict[str, type[TenArchitecture]] = {
    "foten-plus": FotenPlusArchitecture,
    "foten": FotenArchitecture,
    "ten": TenArchitecture,
}
"""What the kernel runs as networks."""
GRAPHS: dict[str, type[TenArchitecture | GraphArchitecture]] = {
    "ten-mfcc": TenMfccArchitecture,
    "ten-wavelet": TenWaveletArchitecture,
    "foten-d": FotenDArchitecture,
    "fnn": FnnArchitecture,
    "dstn": DstnArchitecture,
    "hapinf": HapinfArchitecture,
    "ldhtd": LdhtdArchitecture,
    "ldhtd-hop": LdhtdHopArchitecture,
    "dftnet": DftnetArchitecture,
    "gan": GanArchitecture,
}
"""What ONNX Runtime runs."""
ARCHITECTURES: dict[str, type[Architecture]] = {**NETWORKS, "ar": ArArchitecture, **GRAPHS}


def architecture_from(key: str, sizes: Mapping[str, Any]) -> Architecture:
    """Return the architecture that a card describes.

    Raises:
        ValueError: the model or a size is unknown, or a size is out of range.
    """
    if key not in ARCHITECTURES:
        raise ValueError(f"unknown model {key!r}, expected one of {', '.join(ARCHITECTURES)}")
    known = [field.name for field in fields(ARCHITECTURES[key])]
    unknown = sorted(set(sizes) - set(known))
    if unknown:
        raise ValueError(f"{key} has no size {unknown[0]!r}, expected one of {', '.join(known)}")
    return ARCHITECTURES[key](**sizes)


def sizes(architecture: Architecture) -> dict[str, Any]:
    """Return the sizes as plain JSON values; nothing of an excitation where there is none, or always one."""
    unsaid: set[str] = set()
    if not architecture.excited:
        unsaid = {"excitation", "excitation_width"}
    elif isinstance(architecture, FotenPlusArchitecture):
        unsaid = {"excitation"}
    return {
        name: list(size) if isinstance(size, tuple) else size
        for name, size in asdict(architecture).items()
        if name not in unsaid
    }


def multiply_adds(architecture: Architecture) -> int:
    """Return the multiplications and additions in pairs that a rendered sample costs, without those that change nothing.

    Raises:
        ValueError: it is run as a graph, whose card has them.

    Left out: all but one query of the last temporal layer, all but one sample of Eq. 9, and the magnitudes above half of the
    rate, which are those below it; and the network, where a rendering does not hear it.
    """
    if isinstance(architecture, GraphArchitecture) or architecture.in_graph:
        raise ValueError("what a graph costs is in its card, under metrics")
    if isinstance(architecture, ArArchitecture):
        p, q = architecture.order, architecture.ma
        # Mixed, multiplied out, stepped down to reflections, and run; a hand that keeps still costs the last alone.
        return 3 * (p + q + 2) + 2 * p * p + q * q + 10 * p + q
    linear = 0
    if isinstance(architecture, FotenPlusArchitecture):
        order = architecture.rest_order if architecture.n_tones else architecture.order
        # A sample is forecast and taken in; four vertices are mixed for each reflection and each coefficient of a tone.
        scales = (2 + bool(architecture.n_tones)) * (6 * architecture.excitation_width + 5)
        linear = 10 * order + 12 * architecture.n_tones + scales
        if architecture.n_tones or not architecture.network_heard:
            return linear
    m, d = architecture.window, architecture.d_model

    def layer(n_tokens: int, n_asked: int, width: int) -> int:
        projected = 2 * n_tokens * width * width + n_asked * width * width
        attended = 2 * n_asked * n_tokens * width + n_asked * width * width
        return projected + attended + 2 * n_asked * width * architecture.d_feedforward

    if architecture.excited and not linear:
        linear = 6 * architecture.excitation_width + 10
    temporal = m * architecture.n_inputs * d + (architecture.n_layers - 1) * layer(m, m, d) + layer(m, 1, d)
    spectral = 0
    if isinstance(architecture, FotenArchitecture):
        width, n_bins, n_magnitudes = architecture.spectral_width, architecture.n_bins, m // 2 + 1
        lifted = 2 * width if width > 1 else 0
        n_phase = 2 if architecture.phase_input == "cos_sin" else 1
        spectral = 2 * m * n_magnitudes + 2 * n_bins + d
        for n_tokens, n_inputs in ((n_magnitudes, 1), (n_bins, n_phase)):
            spectral += layer(n_tokens, n_tokens, width) + n_tokens * lifted * (1 + n_inputs) // 2
    first, second = architecture.head
    head = (architecture.n_found + 2) * first + first * second + second
    head += architecture.modulated * 5 * architecture.n_found
    return linear + temporal + spectral + head


def tensor_shapes(architecture: Architecture) -> dict[str, tuple[int, ...]]:
    """Return the name and shape of every tensor of a network, as a texture file holds them.

    Linear maps are (outputs, inputs), as in PyTorch. What is run as a graph has none but that.
    """
    if isinstance(architecture, ArArchitecture):
        n = architecture.n_models
        shapes = {"local.points": (n, 2), "local.lsf": (n, architecture.order), "local.variance": (n,)}
        if architecture.ma:
            shapes |= {"local.ma_lsf": (n, architecture.ma), "local.gain": (n,)}
        shapes |= {"local.triangles": (architecture.n_triangles, 3)}
        return shapes | {f"local.{part}": (2,) for part in ("scale", "mean", "sd")}
    chance: dict[str, tuple[int, ...]] = {}
    if isinstance(architecture, TenArchitecture | PredictorArchitecture) and architecture.excited:
        chance = _excitation(architecture.excitation_width)
    if isinstance(architecture, GraphArchitecture) or architecture.in_graph:
        return chance
    if isinstance(architecture, FotenPlusArchitecture):
        shapes = {f"network.{name}": shape for name, shape in _network_shapes(architecture).items()}
        width = architecture.excitation_width
        shapes |= chance
        shapes |= _lattice("lattice", architecture.n_speed, architecture.n_force, architecture.order, width)
        if architecture.n_tones:
            n_speed, n_force = architecture.n_tone_speed, architecture.n_tone_force
            shapes |= {"tones.speed_knots": (n_speed,), "tones.force_knots": (n_force,)}
            shapes |= {"tones.values": (n_speed * n_force, 2 * architecture.n_tones), "tones.motion": (3,)}
            n_speed, n_force = architecture.n_rest_speed, architecture.n_rest_force
            shapes |= _lattice("rest", n_speed, n_force, architecture.rest_order, width)
        return shapes
    return _network_shapes(architecture) | chance


def _excitation(width: int) -> dict[str, tuple[int, ...]]:
    shapes = _scale("excitation", width) | _linear("excitation.tail", 1, 5)
    return shapes | {"excitation.largest": (2,), "excitation.swell": (2,)}


def _lattice(name: str, n_speed: int, n_force: int, order: int, width: int) -> dict[str, tuple[int, ...]]:
    return {
        f"{name}.speed_knots": (n_speed,),
        f"{name}.force_knots": (n_force,),
        f"{name}.reflections": (n_speed * n_force, order),
        **_scale(f"{name}.level", width),
    }


def _scale(name: str, width: int) -> dict[str, tuple[int, ...]]:
    shapes = _linear(f"{name}.hidden", width, 4) | _linear(f"{name}.out", 1, width)
    shapes |= {f"{name}.power_law.weight": (1, 5), f"{name}.highest": (1,)}
    return shapes | {f"{name}.{part}": (2,) for part in ("mean", "sd", "floor")}


def _linear(name: str, outputs: int, inputs: int) -> dict[str, tuple[int, ...]]:
    return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}


def _encoder(name: str, width: int, d_feedforward: int) -> dict[str, tuple[int, ...]]:
    shapes = _linear(f"{name}.attention_in", 3 * width, width) | _linear(
        f"{name}.attention_out", width, width
    )
    shapes |= _linear(f"{name}.feedforward_in", d_feedforward, width)
    shapes |= _linear(f"{name}.feedforward_out", width, d_feedforward)
    return shapes | {
        f"{name}.{norm}.{part}": (width,) for norm in ("norm_1", "norm_2") for part in ("weight", "bias")
    }


def _network_shapes(architecture: TenArchitecture) -> dict[str, tuple[int, ...]]:
    d, n_found, (first, second) = architecture.d_model, architecture.n_found, architecture.head
    shapes = _linear("temporal.embedding", d, architecture.n_inputs)
    for layer in range(architecture.n_layers):
        shapes |= _encoder(f"temporal.layers.{layer}", d, architecture.d_feedforward)
    if architecture.pre_norm:
        shapes |= {"temporal.norm.weight": (d,), "temporal.norm.bias": (d,)}
    if isinstance(architecture, FotenArchitecture):
        shapes |= _spectral_shapes(architecture)
    if architecture.modulated:
        shapes |= _linear("modulation", 2 * n_found, 2)
    shapes |= _linear("head_1", first, n_found + 2)
    return shapes | _linear("head_2", second, first) | _linear("head_3", 1, second)


def _spectral_shapes(architecture: FotenArchitecture) -> dict[str, tuple[int, ...]]:
    width, shapes = architecture.spectral_width, _linear("spectral_embedding", architecture.d_model, 1)
    for name, n_inputs in (("magnitude", 1), ("phase", 2 if architecture.phase_input == "cos_sin" else 1)):
        shapes |= _encoder(f"spectral.{name}_layer", width, architecture.d_feedforward)
        if width > 1:
            lift, back = (
                _linear(f"spectral.{name}_in", width, n_inputs),
                _linear(f"spectral.{name}_out", 1, width),
            )
            shapes |= lift | back
    if architecture.bin_embedding:
        shapes["spectral.bins"] = (architecture.n_bins, width)
    return shapes
