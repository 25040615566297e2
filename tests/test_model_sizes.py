"""The sizes of the models, the tensors that follow from them, and what they cost."""

from __future__ import annotations

from typing import Any

import pytest

from conftest import exported, sizes_with, untrained, untrained_tensors
from foten.models.foten.sizes import FotenSizes
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.graph import multiply_adds
from foten.models.model_sizes import MAX_WINDOW
from foten.models.piecewise_ar.sizes import PiecewiseArSizes
from foten.models.registry import MAX_GRAPH_WINDOW, MODELS
from foten.models.trainable import TRAINABLE, trainable_sizes
from foten_lab.baselines.networks import NETWORKS
from foten_lab.baselines.sizes import BASELINES

VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "post-norm": {"pre_norm": False, "n_layers": 1},
    "window-7": {"window": 7},
    "literal-width": {"spectral_width": 1},
    "half-of-the-bins": {"bins": "half", "window": 9},
    "tables": {"n_speed": 4, "n_force": 3, "order": 7},
    "tones": {"n_tones": 3, "n_tone_speed": 5, "residual_order": 8, "n_residual_force": 2},
    "with-an-excitation": {"excitation": True, "excitation_width": 5},
}


def test_every_model_but_the_piecewise_has_a_network() -> None:
    assert set(NETWORKS) == {model.sizes for model in TRAINABLE.values() if model.has_network}


@pytest.mark.parametrize("key", [key for key in MODELS if key != "ar"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_tensor_shapes_are_the_networks(key: str, variant: str) -> None:
    """Of PyTorch's modules: network, excitation, levels; tables are as wide as their sizes say."""
    sizes = sizes_with(key, VARIANTS[variant])
    tensors = untrained_tensors(key, sizes, untrained(key, sizes))
    assert sizes.tensor_shapes() == {name: tensor.shape for name, tensor in tensors.items()}


@pytest.mark.parametrize("ma", [0, 5])
def test_tensor_shapes_are_those_of_local_models(ma: int) -> None:
    sizes = PiecewiseArSizes(window=257, order=7, ma=ma, n_models=9, n_triangles=8)
    tensors = exported("ar", sizes).tensors
    result = {name: tensor.shape for name, tensor in tensors.items() if name.startswith("piecewise_ar.")}
    assert sizes.tensor_shapes() == result


@pytest.mark.parametrize("key", TRAINABLE)
def test_sizes_round_trip(key: str) -> None:
    window = {"window": 296, "frame": 88} if key == "gan" else {"window": 99}
    sizes = sizes_with(key, {**window, "head": (12, 5), "order": 4, "excitation": True})
    assert trainable_sizes(key, sizes.to_card()) == sizes


@pytest.mark.parametrize(
    ("model", "change", "match"),
    [
        ("foten-plus", {"window": 1}, "window is 1"),
        ("foten-plus", {"window": MAX_WINDOW + 1}, "window is 513, expected .*512"),
        ("foten-plus", {"n_hidden": 0}, "n_hidden is 0"),
        ("foten-plus", {"n_hidden": 2.0}, "n_hidden is 2.0"),
        ("foten-plus", {"n_hidden": True}, "n_hidden is True"),
        ("foten-plus", {"n_hidden": 10**5000}, "a number of thousands of digits"),
        ("foten-plus", {"recorded": 1}, "recorded is 1, expected true or false"),
        ("foten-plus", {"n_tones": -1}, "n_tones is -1"),
        ("foten-plus", {"width": 3}, "has no size 'width'"),
        ("foten", {"d_model": 30}, "does not divide"),
        ("foten", {"spectral_width": 6}, "does not divide into 4 heads"),
        ("foten", {"head": [10]}, "two layers"),
        ("foten", {"head": [10, 0]}, "head is 0"),
        ("foten", {"bins": "some"}, "'all' or 'half'"),
        ("hapinf", {"d_model": 30}, "does not divide"),
        ("hapinf", {"n_start": 30}, "at most the window"),
        ("ldhtd", {"n_heads": 5}, "does not divide"),
        ("fnn", {"window": 95}, "expected 96 or more"),
        ("ten-mfcc", {"n_coefficients": 20}, "at most n_bands"),
        ("ten-wavelet", {"window": 12}, "expected 16 or more for 3 levels"),
        ("dftnet", {"n_conditions": 101}, "expected 101 or more"),
        ("gan", {"frame": 32}, "expected 240"),
        ("gan", {"frame": 4}, "frame is 4"),
        ("gan", {"frame": 66, "window": 274}, "a multiple of stride, 8"),
        ("ar", {"order": 41, "window": 42}, "order is 41, expected 40 at most"),
        ("ar", {"ma": 41}, "ma is 41, expected 40 at most"),
        ("ar", {"window": 20}, "window is 20, expected a whole number, 21 or more"),
        ("ar", {"n_models": 2}, "n_models is 2"),
    ],
)
def test_impossible_sizes_are_refused(model: str, change: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        trainable_sizes(model, change)


def test_no_window_is_longer_than_what_renders_it_takes() -> None:
    assert sizes_with("fnn", {"window": 96}).history == 96  # the shortest
    for key, model in TRAINABLE.items():
        longest = MAX_GRAPH_WINDOW if key in BASELINES else MAX_WINDOW
        window = {"frame": longest - 26 * 8 + 8, "stride": 8} if key == "gan" else {}
        with pytest.raises(ValueError, match=f"window is {longest + 8}, expected .*{longest}"):
            model.sizes(window=longest + 8, **window)


def test_a_rendering_of_ours_costs_a_thousandth_of_the_papers() -> None:
    paper = FotenSizes().multiply_adds()
    assert paper == pytest.approx(1.05e6, rel=0.01)  # summed by hand, layer by layer
    assert FotenPlusSizes(n_tones=6, residual_order=40).multiply_adds() < 1000
    assert FotenPlusSizes(order=40).multiply_adds() < 1000
    assert TRAINABLE["fnn"].sizes().multiply_adds() is None  # its card alone knows


def test_what_a_network_costs_is_near_what_pytorch_counts() -> None:
    """Oracle: PyTorch's own counter, which counts all of Eq. 9 and no symmetry of the magnitudes, so more."""
    for key in ("foten", "ten"):
        sizes = TRAINABLE[key].sizes()
        counted = multiply_adds(untrained(key, sizes), sizes.window)
        assert 0.6 * counted < sizes.multiply_adds() <= counted, key


def test_a_card_without_excitation_has_no_size_of_one() -> None:
    assert "excitation_width" not in FotenSizes().to_card()
    assert FotenSizes(excitation=True).to_card()["excitation_width"] == 16
