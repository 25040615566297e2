"""The sizes of the networks and the tensors that follow from them."""

from __future__ import annotations

from typing import Any

import pytest
from foten.architecture import (
    ARCHITECTURES,
    NETWORKS,
    FotenArchitecture,
    FotenPlusArchitecture,
    architecture_from,
    multiply_adds,
    sizes,
    tensor_shapes,
)

from conftest import architecture_with
from foten.networks import build

VARIANTS: list[dict[str, Any]] = [
    {},
    {"pre_norm": False, "n_layers": 1},
    {"phase_input": "cos_sin", "bin_embedding": True, "window": 7},
    {"spectral_width": 1},
    {"bins": "half", "bin_embedding": True, "window": 9},
    {"bins": "half", "magnitude_input": "log"},
]


@pytest.mark.parametrize("key", NETWORKS)
@pytest.mark.parametrize("variant", VARIANTS)
def test_tensor_shapes_are_the_networks(key: str, variant: dict[str, Any]) -> None:
    architecture = architecture_with(key, variant)
    state = build(key, architecture).state_dict()
    assert tensor_shapes(architecture) == {name: tuple(tensor.shape) for name, tensor in state.items()}


@pytest.mark.parametrize("key", ARCHITECTURES)
def test_sizes_round_trip(key: str) -> None:
    own = {"window": 296, "frame": 88} if key == "gan" else {"window": 99}
    architecture = architecture_with(key, {**own, "head": (12, 5), "order": 4})
    assert architecture_from(key, sizes(architecture)) == architecture


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"window": 1}, "window is 1"),
        ({"n_heads": 0}, "n_heads is 0"),
        ({"n_heads": -2}, "n_heads is -2"),
        ({"n_layers": 0}, "n_layers is 0"),
        ({"n_layers": 2.0}, "n_layers is 2.0"),
        ({"d_model": 10**9}, "d_model is 1000000000"),
        ({"d_model": 30}, "does not divide"),
        ({"spectral_width": 0}, "spectral_width is 0"),
        ({"head": [10]}, "two layers"),
        ({"head": "ab"}, "two layers"),
        ({"head": [10, 0]}, "head is 0"),
        ({"phase_input": "sine"}, "cos_sin"),
        ({"magnitude_input": "db"}, "'linear' or 'log'"),
        ({"bins": "some"}, "'all' or 'half'"),
        ({"spectral_width": 1, "phase_input": "cos_sin"}, "needs a spectral_width above 1"),
        ({"pre_norm": 1}, "true or false"),
        ({"excitation_width": 0}, "excitation_width is 0"),
        ({"correction_limit": 0}, "correction_limit is 0"),
        ({"correction_limit": "3"}, "correction_limit is '3'"),
        ({"width": 3}, "has no size 'width'"),
    ],
)
def test_impossible_sizes_are_refused(change: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        architecture_from("foten-plus", change)


def test_unknown_models_are_refused() -> None:
    with pytest.raises(ValueError, match="expected one of foten-plus, foten, ten, ar"):
        architecture_from("fotan", {})


def test_our_network_costs_no_more_than_a_quarter_above_the_papers() -> None:
    paper = multiply_adds(FotenArchitecture())
    assert paper == pytest.approx(1.05e6, rel=0.01)  # summed by hand, layer by layer
    for order in (20, 240):
        assert multiply_adds(FotenPlusArchitecture(order=order)) < 1.01 * paper
    assert multiply_adds(FotenPlusArchitecture(order=240, hand="modulation")) < 1.25 * paper
    # Tones and a lattice alone: no network.
    assert multiply_adds(FotenPlusArchitecture(n_tones=6, rest_order=40)) < 1000
    assert multiply_adds(FotenPlusArchitecture(order=40, network_heard=False)) < 1000
