"""What several tests need: textures of untrained networks with a known lattice, made in milliseconds."""

from __future__ import annotations

import gzip
import json
import os
import re
import signal
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from foten.dsp.equaliser import N_TERMS, Equaliser
from foten.dsp.level import N_BANDS
from foten.models.excitation import Excitation, Scale
from foten.models.foten_plus.recorded_innovations import (
    CANDIDATE,
    FORCE_FLOOR,
    FORCE_ORIGIN,
    N_AHEAD,
    N_GROWTH,
    RUN_START,
    SPEED_FLOOR,
    SPEED_ORIGIN,
    STORED_SHIFT,
    RecordedInnovations,
    logarithm,
)
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.model_sizes import ModelSizes
from foten.models.piecewise_ar.sizes import PiecewiseArSizes
from foten.models.registry import GraphSizes
from foten.models.texture_file import Texture
from foten.models.trainable import TRAINABLE, recipe_of
from foten.recording.preprocess import PreprocessConfig
from foten.recording.scaling import Scaling
from foten.recording.split import Split
from foten.training.config import TrainConfig
from foten_lab.baselines.sizes import NoiseModelSizes

if TYPE_CHECKING:
    from foten.models.piecewise_ar.local_models import LocalModels
    from foten.training.window_fit import Packed

torch.set_num_threads(1)  # small matrices only lose by more
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as a shell sets it for what runs in its background
    signal.signal(signal.SIGINT, signal.default_int_handler)

SMALL: dict[str, Any] = {
    "d_model": 8,
    "n_heads": 2,
    "n_layers": 2,
    "d_feedforward": 12,
    "head": (10, 6),
    "spectral_width": 4,
}
"""ModelSizes of a network that is quick to run and has every part."""

PLUS: dict[str, Any] = {"window": 12, "n_hidden": 6, "head_width": 5, "n_components": 3}
"""The same of foten-plus."""


def sizes_with(model: str, wanted: dict[str, Any]) -> ModelSizes:
    """A model's sizes with those that are wanted and that it has."""
    has = {field.name for field in fields(TRAINABLE[model].sizes)}
    return TRAINABLE[model].sizes(**{name: value for name, value in wanted.items() if name in has})


def config_of(model: str, **wanted: Any) -> TrainConfig:
    """A model's default recipe with those settings that are wanted and that it has."""
    return recipe_of(model, **{name: value for name, value in wanted.items() if name in TRAINABLE[model].settings})


SCALING = Scaling(mean=(0.1, 100.0, 1.0), sd=(2.0, 60.0, 0.5))
CARD: dict[str, Any] = {
    "rate_hz": 1000.0,
    "trained_range": {"speed": [8.0, 220.0], "force": [0.3, 2.5]},
    "extrapolation_exponents": {"speed": 0.7, "force": 0.4},
    "saturation": 12.0,
    "lowpass_hz": 20.0,
    "delay_ms": 11.3,
    "warm_start": {"asked": {"speed": 45.0, "force": 0.8}, "recorded": {"speed": 45.0, "force": 0.8}},
    "texture": "untrained",
    "tool": "",
    "sensors": "",
    "notes": "",
    "licence": "",
    "recording_sha256": "",
    "preprocess": asdict(PreprocessConfig()),
    "split": asdict(Split((0, 1, 2), (3,), (4,), 5, 2000, "regrouped", 0)),
    "split_sha256": "",
    "training": {},
    "metrics": {"validation_mae_scaled": 0.5},
}


def resonance(hz: float, radius: float, m: int, rate_hz: float = 1000.0) -> np.ndarray:
    """M taps, oldest first, of a stable AR(2) with poles at ±hz."""
    taps = np.zeros(m)
    taps[-2:] = -(radius**2), 2 * radius * np.cos(2 * np.pi * hz / rate_hz)
    return taps


def reflections_of(taps: np.ndarray) -> np.ndarray:
    """The two reflection coefficients of an AR(2), taps oldest first."""
    second, first = -taps
    return np.array([first / (1 + second), second])


def untrained(model: str, sizes: ModelSizes | None = None, seed: int = 0) -> Any:
    """A seeded network in PyTorch whose every parameter matters."""
    import torch

    from foten_lab.baselines.networks import build

    torch.manual_seed(seed)
    return perturbed(build(sizes or TRAINABLE[model].sizes()))


def perturbed(network: Any) -> Any:
    """A network with seeded changes to every parameter."""
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
    return network.eval()


def scale(width: int, level: float, seed: int) -> Scale:
    """A seeded scale over speed and force that grows with both."""
    rng = np.random.default_rng(seed)
    return Scale(
        hidden_weight=rng.uniform(-0.6, 0.6, (width, 4)),
        hidden_bias=rng.uniform(-0.6, 0.6, width),
        out_weight=0.1 * rng.standard_normal((1, width)),
        out_bias=np.array([level]),
        exponents=np.array([0.7, 0.4, 0.0, 0.0, 0.0]),
        sigma_max=np.array([1e6]),
        mean=np.array(SCALING.mean[1:]),
        sd=np.array(SCALING.sd[1:]),
        floor=np.array([2.0, 0.05]),
    )


def untrained_tensors(model: str, sizes: ModelSizes, network: Any, seed: int = 0) -> dict[str, np.ndarray]:
    """A network's tensors and seeded ones of all else; foten-plus resonates near 120 Hz through its lattice."""
    from foten.training.texture_builder import tensors_of

    tensors: dict[str, np.ndarray] = {}
    if isinstance(sizes, GraphSizes | NoiseModelSizes):
        tensors = packed(network, sizes).tensors
    else:
        tensors = tensors_of(network, "network." if model == "foten-plus" else "")
    if sizes.excited:
        width = sizes.excitation_width  # type: ignore[attr-defined]
        tensors |= Excitation(scale(width, 0.0, seed), (1e6, 1e6)).tensors()
    if isinstance(sizes, FotenPlusSizes) and sizes.equalised:
        weights = 0.1 * np.random.default_rng(seed + 3).standard_normal((N_BANDS, N_TERMS))
        tensors |= Equaliser.of_weights(weights, CARD["rate_hz"]).tensors()
    if isinstance(sizes, FotenPlusSizes) and sizes.recorded:
        tensors |= recorded(seed).tensors()
    if isinstance(sizes, FotenPlusSizes):
        rng = np.random.default_rng(seed)
        prefixes = ["lattice.", *(["residual."] if sizes.n_tones else [])]
        for prefix in prefixes:
            tensors |= scale(width, float(np.log(0.3)), seed + 1).tensors(f"{prefix}level.")
        for prefix in [*prefixes, *(["tones."] if sizes.n_tones else [])]:
            for name, shape in sizes.tensor_shapes().items():
                if name == f"{prefix}speed_knots":
                    tensors[name] = np.linspace(10.0, 200.0, shape[0])
                elif name == f"{prefix}force_knots":
                    tensors[name] = np.linspace(-1.0, 0.9, shape[0])
                elif name == f"{prefix}reflections":
                    tensors[name] = 0.02 * rng.standard_normal(shape)
                    if shape[1] > 1:
                        tensors[name][:, :2] += reflections_of(resonance(120.0, 0.95, 2))
                elif name == "tones.values":
                    tensors[name] = rng.standard_normal(shape)
                elif name == "tones.phase_params":
                    tensors[name] = np.array([2 * np.pi / 2.5 / 1000, 0.03, 2e-3])
    return tensors


def recorded(seed: int = 0, n: int = 90, step: int = 4) -> RecordedInnovations:
    """Seeded recorded innovations in two runs of n moments, their speed from about 8 to 220 mm/s and their force 0.3 to 2.5 N."""
    rng, j = np.random.default_rng(seed), np.arange(2 * n)
    speed = 114 + 106 * np.sin(2 * np.pi * j / 70 + np.repeat([0.0, 1.0], n))
    force = 1.4 + 1.1 * np.sin(2 * np.pi * j / 33)
    logs = [
        logarithm(speed, SPEED_FLOOR) - SPEED_ORIGIN >> STORED_SHIFT,
        logarithm(force, FORCE_FLOOR) - FORCE_ORIGIN >> STORED_SHIFT,
    ]
    flags = np.where((j % n >= N_GROWTH) & (n - j % n >= N_AHEAD), CANDIDATE, 0) | np.where(j % n == 0, RUN_START, 0)
    moments = np.stack([*logs, *rng.integers(100, 150, (2, 2 * n)), flags], axis=1).astype(np.uint8)
    values = np.linspace(-3, 3, 256).astype(np.float32).astype(float)
    return RecordedInnovations(values, rng.integers(0, 256, (2 * n, step), dtype=np.uint8), moments, False)


def local_models(sizes: PiecewiseArSizes) -> LocalModels:
    """Seeded local models, silent at rest, over a fan of triangles; the first stands in the middle."""
    from foten.models.piecewise_ar.local_models import LocalModels

    rng = np.random.default_rng(2)
    n, p, q = sizes.n_models, sizes.order, sizes.ma
    turn = 2 * np.pi * np.arange(n - 1) / (n - 1)
    rim = np.stack([110 + 109 * np.cos(turn), 1.3 + 1.2 * np.sin(turn)], axis=1)
    lsf, ma_lsf = (np.pi * (np.arange(1, k + 1) + rng.uniform(-0.4, 0.4, (n, k))) / (k + 1) for k in (p, q))
    variance = rng.uniform(0.01, 0.2, n)
    variance[-1] = 0.0
    fan = np.array([[0, 1 + i, 1 + (i + 1) % (n - 1)] for i in range(n - 1)])
    return LocalModels(
        np.concatenate([[[110.0, 1.3]], rim]),
        lsf,
        variance,
        fan[: sizes.n_triangles],
        np.array([60.0, 0.5]),
        ma_lsf,
        rng.uniform(0.5, 1.5, n) if q else np.ones(n),
    )


def exported(
    model: str, sizes: ModelSizes | None = None, tensors: dict[str, np.ndarray] | None = None, **card: Any
) -> Texture:
    """An untrained network, or local models that nobody fitted, as a proved texture; tensors and card replace some of its own."""
    from foten.models.definitions import model_of
    from foten.models.piecewise_ar.local_models import local_texture
    from foten.runtime.proof import proved

    if model == "ar":
        sizes = sizes or TRAINABLE[model].sizes(n_models=9, n_triangles=8)  # type: ignore[call-arg]
        assert isinstance(sizes, PiecewiseArSizes)
        return local_texture(local_models(sizes), SCALING, {**CARD, **card}).texture
    sizes = sizes or TRAINABLE[model].sizes()
    network = untrained(model, sizes)
    all_tensors = {**untrained_tensors(model, sizes, network), **(tensors or {})}
    rng = np.random.default_rng(1)
    windows = rng.standard_normal((32, sizes.history, 3))
    warm_start = 0.5 * rng.standard_normal((sizes.history, 3))
    in_file, definition, metrics = sizes, model_of, CARD["metrics"]
    if isinstance(sizes, GraphSizes | NoiseModelSizes):
        graph = packed(network, sizes)
        in_file, definition, metrics = graph.sizes, graph.definition, {**metrics, **graph.metrics}
    card = {**CARD, "metrics": metrics, **card}
    return proved(model, in_file, all_tensors, SCALING, windows, warm_start, card, definition).texture


def packed(network: Any, sizes: GraphSizes | NoiseModelSizes) -> Packed:
    """A baseline's network as its texture file holds it."""
    from foten_lab.baselines.fit import noise_graph, one_step_graph

    return noise_graph(network, sizes, 0.5) if isinstance(sizes, NoiseModelSizes) else one_step_graph(network, sizes)


@pytest.fixture(scope="session")
def texture() -> Texture:
    """A foten-plus texture: rings at 120 Hz, excited, trained for 8–220 mm/s and 0.3–2.5 N."""
    return exported("foten-plus", TRAINABLE["foten-plus"].sizes(**PLUS, order=6, n_speed=3, n_force=2))


@pytest.fixture(scope="session")
def plain_texture() -> Texture:
    """A texture of the paper's network, without excitation."""
    return exported("foten", TRAINABLE["foten"].sizes(**SMALL))


TINY = """
title = "Two methods"
seconds = 8
textures = ["linear-cloth", "linear-twin"]
methods = [{model = "fnn", name = "FNN [13]"}, {model = "fnn", name = "excited", sizes = {excitation = true}}]
[train]
epochs = 1
[preprocess]
trim_ms = 0
block_ms = 1000
"""


def experiment(folder: Path, text: str = TINY) -> Path:
    """The path of an experiment, written to a folder."""
    path = folder / "experiment.toml"
    path.write_text(text)
    return path


NUMBER = re.compile(r"-?\d+\.?\d*(?:e[-+]\d+)?")
LOOKS = """visible alpha zorder label text color facecolor edgecolor linewidth linestyle _unscaled_dash_pattern _solidcapstyle
marker markersize markerfacecolor sizes fontsize rotation ha va clim cmap norm name interpolation origin array bbox_patch boxstyle
pad xy xycoords xyann anncoords _loc _outside_loc _ncols columnspacing borderaxespad frame_on texts legend_handles"""
PLAIN = re.compile(r"|None|T|0|solid|\(\)|\(0 None\)|_child\d+|_nolegend_|DejaVu Sans|CapStyle.projecting|Normalize")


def check_figures(drawn: Mapping[str, Any]) -> None:
    """Hold figures to what `figures.json.gz` says that they show: words exactly, numbers to 0.2 % or 0.002.

    Places are fractions of the axes, of which 0.002 is about a pixel. Another instruction set adds in another order, which
    changes numbers in their last digits, far below that. FOTEN_FIGURES=write writes the file anew, and each figure to
    build/figures: look at these before you commit it.
    """
    path, folder = Path(__file__).with_name("figures.json.gz"), Path(__file__).parents[1] / "build" / "figures"
    lines = {name: list(shown(figure)) for name, figure in drawn.items()}
    stored = json.loads(gzip.decompress(path.read_bytes()))
    if os.environ.get("FOTEN_FIGURES") == "write":
        stored |= lines
        path.write_bytes(gzip.compress(json.dumps(stored, indent=0, sort_keys=True).encode(), mtime=0))
        folder.mkdir(parents=True, exist_ok=True)
        for name, figure in drawn.items():
            figure.savefig(folder / f"{name}.png", dpi=70)
    for name in drawn:
        words, expected = ([NUMBER.sub("#", line) for line in of[name]] for of in (lines, stored))
        assert words == expected, name
        for line, wanted in zip(lines[name], stored[name], strict=True):
            numbers = (np.array(NUMBER.findall(text), dtype=float) for text in (line, wanted))
            np.testing.assert_allclose(*numbers, rtol=2e-3, atol=2e-3, err_msg=f"{name}: {line}, expected {wanted}")


def shown(figure: Any) -> Iterator[str]:
    """What a figure shows, in lines: its size, each of its axes, and each artist's look and place."""
    yield _text([*figure.get_size_inches(), len(list(figure._align_label_groups["y"]))])
    for axes in figure.axes:
        if not axes.get_visible():
            continue
        spines = [name for name, spine in axes.spines.items() if spine.get_visible()]
        yield _text([axes.get_position().bounds, axes.get_box_aspect(), axes.get_facecolor(), spines])
        for i, axis in enumerate((axes.xaxis, axes.yaxis)):
            limits = axis.get_transform().transform(np.array(axis.get_view_interval()))
            ticks = [(tick.get_position()[i], tick.get_text()) for tick in axis.get_ticklabels()]
            params = [sorted(axis.get_tick_params(which).items()) for which in ("major", "minor")]
            looks = [[value for _, value in one] for one in params]
            yield _text([axis.get_scale(), limits, ticks, looks, axis.label])
        for artist in axes.get_children():
            words = getattr(artist, "get_text", lambda: None)()
            if words != "" and artist is not axes.patch and not type(artist).__name__.endswith(("Axis", "Spine")):
                yield f"{_text(artist)} {_text(_points(artist, axes))}"
    yield from map(_text, [*figure.texts, *figure.legends])


def _points(artist: Any, axes: Any) -> list[float]:
    """Number of an artist's points, and the first, last, mean and standard deviation, in fractions of the axes."""
    transform = artist.get_transform()
    if hasattr(artist, "get_xydata"):
        points = artist.get_xydata()
    elif hasattr(artist, "get_extent"):
        points, transform = np.reshape(artist.get_extent(), (2, 2)).T, axes.transData
    elif hasattr(artist, "get_paths"):
        scattered = len(artist.get_offsets()) > 1
        points = artist.get_offsets() if scattered else [xy for path in artist.get_paths() for xy in path.vertices]
        transform = artist.get_offset_transform() if scattered else transform
    elif hasattr(artist, "get_path"):
        points = artist.get_path().vertices
    else:
        legend = hasattr(artist, "get_bbox_to_anchor")
        points = artist.get_bbox_to_anchor().get_points() if legend else [artist.get_position()]
    placed = axes.transAxes.inverted().transform(transform.transform(np.reshape(points, (-1, 2)).astype(float)))
    placed = placed[np.isfinite(placed).all(axis=1)].clip(-0.1, 1.1)  # how far beyond the axes nobody sees
    ends = [placed[0], placed[-1], placed.mean(axis=0), placed.std(axis=0)] if len(placed) else []
    return [len(placed), *np.ravel(ends)]


def _text(value: Any) -> str:
    """A value in words and numbers; of many numbers, how many, mean, standard deviation and range."""
    if value is None or isinstance(value, str | bool | np.bool_):
        return str(value)[0] if isinstance(value, bool | np.bool_) else str(value)
    if isinstance(value, float | int | np.number):
        return f"{round(float(value), 6) + 0.0:.4g}"
    if isinstance(value, np.ndarray) and value.size > 8:
        value = np.ma.masked_invalid(value).compressed()
        value = [value.size, value.mean(), value.std(), value.min(), value.max()]
    if isinstance(value, list | tuple | np.ndarray):
        return f"({' '.join(map(_text, value))})"
    words = [type(value).__name__]
    for name in LOOKS.split():
        look = _text(getattr(value, f"get_{name}")() if hasattr(value, f"get_{name}") else getattr(value, name, None))
        words += [f"{name} {look}"] * (not PLAIN.fullmatch(look))
    return " ".join(words)
