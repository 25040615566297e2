import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from foten.architecture import ARCHITECTURES, GRAPHS, NETWORKS, FotenArchitecture, FotenPlusArchitecture
from foten.runtime.engine import ENGINES, engine_for
from foten.runtime.forecast import excitation_fit

from conftest import SMALL, architecture_with, exported, untrained
from foten.evaluate.one_step import excitation_scores
from foten.families.texture_file import ONE_STEP_TOLERANCE, Texture, texture_from_bytes
from foten.networks import MODELS

VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "post-norm": {**SMALL, "pre_norm": False},
    "cos-sin": {**SMALL, "phase_input": "cos_sin"},
    "bin-embedding": {**SMALL, "bin_embedding": True},
    "all-of-them": {**SMALL, "pre_norm": False, "phase_input": "cos_sin", "bin_embedding": True},
    "literal-width": {**SMALL, "spectral_width": 1},
    "window-5": {**SMALL, "window": 5},
    "window-30": {**SMALL, "window": 30},
    "one-layer": {**SMALL, "n_layers": 1},
    "one-head": {**SMALL, "n_heads": 1},
    "half-of-the-bins": {**SMALL, "bins": "half"},
    "half-of-odd-bins": {**SMALL, "bins": "half", "window": 9, "bin_embedding": True},
    "log-magnitude": {**SMALL, "magnitude_input": "log"},
}
PLUS = {
    "hand-in-tokens": {**SMALL, "hand": "tokens"},
    "hand-modulates": {**SMALL, "hand": "modulation"},
    "network-not-heard": {**SMALL, "network_heard": False, "order": 7},
    "a-table": {**SMALL, "order": 7, "n_speed": 4, "n_force": 3},
    "tones": {**SMALL, "order": 5, "n_tones": 3, "n_tone_speed": 5, "n_tone_force": 2, "rest_order": 8},
    "level-drives": {**SMALL, "order": 7, "n_speed": 4, "n_force": 3, "level_drives": True},
    "level-drives-the-rest": {**SMALL, "n_tones": 2, "rest_order": 6, "rest_level_drives": True},
    "tones-on-a-table": {**SMALL, "n_tones": 2, "n_tone_speed": 4, "n_rest_speed": 3, "n_rest_force": 2},
}
CASES = [
    *(
        (key, name)
        for key, architecture in NETWORKS.items()
        for name, wanted in VARIANTS.items()
        if set(wanted) - set(SMALL) <= {field.name for field in dataclasses.fields(architecture)}
        and (name != "literal-width" or key != "ten")
    ),
    *(("foten-plus", name) for name in PLUS),
]


def test_the_registries_have_the_same_models() -> None:
    assert set(NETWORKS) | set(GRAPHS) == set(MODELS)
    assert set(ARCHITECTURES) == set(ENGINES)


@pytest.mark.parametrize(("key", "variant"), CASES)
def test_the_engine_is_the_network(key: str, variant: str) -> None:
    """Seam: PyTorch in float64 on the same tensors."""
    architecture = architecture_with(key, {**VARIANTS, **PLUS}[variant])
    network = untrained(key, architecture)
    tensors = {name: tensor.numpy() for name, tensor in network.state_dict().items()}
    engine = ENGINES[key](architecture, tensors)
    rng = np.random.default_rng(0)
    m = architecture.history
    rows = rng.standard_normal((60, m, 3))
    constant = np.repeat(rng.standard_normal((5, 1, 3)), m, axis=1)  # a spectrum of zeros but one
    alternating = rows[:5] * 0
    alternating[:, :, 0] = (-1.0) ** np.arange(m)  # Nyquist alone, on the negative axis for odd phase
    windows = np.concatenate(
        [rows, 10 * rows[:5], 1e-6 * rows[:5], 0 * rows[:1], constant, -constant, alternating]
    )
    with torch.no_grad():
        expected = network.double()(torch.from_numpy(windows)).numpy()
    smooth = np.arange(len(windows)) < 70  # where no bin is zero but for rounding, which has any phase
    found = engine.predict(windows)
    assert found.shape == (len(windows),)
    assert expected[smooth].std() > 1e-3
    # float32 against float64: what the golden windows allow, and as a share where ten-fold windows answer louder.
    np.testing.assert_allclose(
        found[smooth], expected[smooth], rtol=ONE_STEP_TOLERANCE, atol=ONE_STEP_TOLERANCE
    )
    assert np.abs(found - expected)[smooth].mean() < ONE_STEP_TOLERANCE / 5
    assert np.isfinite(found).all()


@pytest.mark.parametrize("key", ENGINES)
def test_it_is_stateless_and_takes_windows_in_any_number(key: str) -> None:
    texture = exported(key)
    engine = engine_for(texture)
    windows = np.random.default_rng(0).standard_normal((9, texture.window, 3))
    before = windows.copy()
    together = engine.predict(windows)
    alone = np.concatenate([engine.predict(window[None]) for window in windows[::-1]])[::-1]
    # Products of other shapes sum in another order, in float32.
    np.testing.assert_allclose(alone, together, atol=ONE_STEP_TOLERANCE)
    np.testing.assert_array_equal(windows, before)


def test_the_excitations_scale_is_the_networks(texture: Texture) -> None:
    network = untrained("foten-plus", texture.architecture).double()
    windows = 2 * np.random.default_rng(0).standard_normal((50, texture.window, 3))
    with torch.no_grad():
        expected = network.forecast(network.start(torch.from_numpy(windows)))[1].numpy()
    _, sd = network.excitation.swell.numpy()
    expected = expected * np.exp(-(float(sd) ** 2))  # where no shock was heard yet
    np.testing.assert_allclose(engine_for(texture).start(windows).forecast().scale, expected, rtol=1e-12)
    assert expected.std() > 1e-3


@pytest.mark.parametrize("key", ENGINES)
def test_every_tensor_of_the_network_is_needed(key: str) -> None:
    texture = exported(key)
    for name in texture.tensors:
        without = {other: tensor for other, tensor in texture.tensors.items() if other != name}
        with pytest.raises(ValueError, match=r"has shape None|0 golden windows"):
            texture_from_bytes(dataclasses.replace(texture, tensors=without).to_bytes())


@pytest.mark.parametrize(
    "name",
    [
        "head_1.weight",
        "temporal.layers.1.attention_in.weight",
        "spectral.phase_in.weight",
        "temporal.norm.weight",
    ],
)
def test_a_tensor_of_another_size_is_refused(plain_texture: Texture, name: str) -> None:
    tensors = {**plain_texture.tensors, name: plain_texture.tensors[name][:-2]}
    with pytest.raises(ValueError, match=f"tensor '{name}' has shape"):
        texture_from_bytes(dataclasses.replace(plain_texture, tensors=tensors).to_bytes())


def test_bins_that_hold_only_rounding_have_no_phase(texture: Texture) -> None:
    """Constant and alternating windows leave empty bins; 1e-9 of a change must not turn their phases."""
    engine = engine_for(texture)
    signs = np.where(np.arange(texture.window) % 2, -1.0, 1.0)
    for shape in (np.ones(texture.window), signs):
        windows = np.zeros((1, texture.window, 3))
        windows[0, :, 0] = 12 * shape
        # float32 rounding of a smooth function; a turned phase moved it by 4e-3 and more.
        assert engine.predict(windows) == pytest.approx(engine.predict(windows * (1 + 1e-9)), abs=1e-5)


def test_a_model_without_an_engine_is_named(plain_texture: Texture) -> None:
    unknown = dataclasses.replace(plain_texture, card={**plain_texture.card, "model": "wavenet"})
    with pytest.raises(
        ValueError, match="no engine runs model 'wavenet', expected one of foten-plus, foten, ten, ar"
    ):
        engine_for(unknown)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"window": 1}, "window is 1"),
        ({"d_model": 30}, "does not divide into 4 heads"),
        ({"spectral_width": 6}, "does not divide into 4 heads"),
        ({"phase_input": "sine"}, "expected 'angle' or 'cos_sin'"),
    ],
)
def test_sizes_are_checked(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FotenArchitecture(**fields)


def test_scores_are_those_of_the_forecast_that_a_rendering_hears() -> None:
    """The excitation of a rendering without the network says nothing of the errors of a prediction with it."""
    rng = np.random.default_rng(0)
    for heard in (False, True):
        architecture = FotenPlusArchitecture(**{**SMALL, "network_heard": heard})
        engine: Any = engine_for(exported("foten-plus", architecture))
        samples = rng.standard_normal((2 * 120, 3))
        n = np.array([[60], [180]]) + np.arange(50)
        scores = excitation_scores(engine, samples, n, np.ones(n.shape, dtype=bool))
        rows = np.stack([samples[row[0] - engine.window : row[-1] + 1] for row in n])
        followed = engine.follow(rows, corrected=heard)
        _, nats = excitation_fit(followed, samples[n, 0])
        assert scores["nll"] == pytest.approx(nats.mean())
        assert engine.follow(rows, corrected=not heard).scale is None
        assert np.abs(engine.follow(rows, corrected=not heard).sample - followed.sample).max() > 1e-3
