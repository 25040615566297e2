"""The systems that foten is compared with: their fixed parts do what they are named for, and what they are taught is told."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.fft import dct
from scipy.signal import welch

from foten.architecture import (
    GRAPHS,
    FnnArchitecture,
    TenMfccArchitecture,
    TenWaveletArchitecture,
    architecture_from,
)
from foten.models import build
from foten.models.excited import Excited
from foten.models.features import MfccBranch, WaveletBranch, cosine_transform, mel_bands, wavelet_transform
from foten.models.fnn import EDGES, lagged_bands
from foten.train.config import OWN_RECIPES, RECIPES, TrainConfig
from foten.train.export import _multiply_adds
from foten.train.fit import Data, Progress
from foten.train.train import _taught


def test_bands_add_up_to_the_vibration() -> None:
    """At the first lag: all four bands' last sample is the window's last sample."""
    bands = lagged_bands(144, 10)
    np.testing.assert_allclose(bands[:, 0].sum(axis=0), np.eye(1, 144, 143)[0], atol=1e-12)
    # The lags of a band are the same filter, shifted.
    for band, spacing in zip(bands, (8, 4, 2, 1), strict=True):
        np.testing.assert_array_equal(band[1, : 144 - spacing], band[0, spacing:])


def test_each_band_holds_its_frequencies() -> None:
    """White noise through the filter of each band: most of its power lies between the band's edges, give or take the slopes."""
    noise = np.random.default_rng(0).standard_normal(200_000)
    edges = (0.0, *EDGES, 0.5)
    for k, band in enumerate(lagged_bands(144, 10)[:, 0]):
        f, p = welch(np.convolve(noise, band[::-1], mode="valid"), nperseg=512)
        inside = (f >= 0.7 * edges[k]) & (f <= 1.4 * edges[k + 1])
        assert p[inside].sum() > 0.6 * p.sum()


def test_cosine_transform_is_scipys() -> None:
    x = np.random.default_rng(1).standard_normal((5, 12))
    np.testing.assert_allclose(x @ cosine_transform(12, 7), dct(x, norm="ortho")[:, :7], atol=1e-12)


@pytest.mark.parametrize(("n_bins", "n_bands"), [(16, 12), (16, 5), (65, 20)])
def test_mel_bands_rise_and_are_means(n_bins: int, n_bands: int) -> None:
    bands = mel_bands(n_bins, n_bands)
    np.testing.assert_allclose(bands.sum(axis=0), 1)
    assert (bands >= 0).all()
    middle = (bands * np.arange(n_bins)[:, None]).sum(axis=0)
    assert (np.diff(middle) > 0).all()


def test_cepstrum_follows_the_level_in_its_first_coefficient_alone() -> None:
    """Twice as loud adds log 4 to every band: √n · log 4 to the first coefficient, nothing to the others."""
    branch = MfccBranch(TenMfccArchitecture(n_bands=6, n_coefficients=6))
    x = torch.from_numpy(np.random.default_rng(2).standard_normal((4, 30)))
    louder = (branch(2 * x) - branch(x)).numpy()
    np.testing.assert_allclose(louder[:, 0], np.sqrt(6) * np.log(4), rtol=1e-3)
    np.testing.assert_allclose(louder[:, 1:], 0, atol=2e-3)


def test_wavelets_keep_what_is_smooth_out_of_the_details() -> None:
    """Two vanishing moments: a straight line has no details but at the mirrored beginning; energy inside is kept."""
    transform = wavelet_transform(64, 3)
    assert transform.shape[1] == WaveletBranch(TenWaveletArchitecture(window=64)).transform.shape[1]
    line = np.linspace(-1, 2, 64)
    details = line @ transform[:, :32]
    assert np.abs(details[:-2]).max() < 1e-12
    x = np.zeros(64)
    x[30:50] = np.random.default_rng(3).standard_normal(20)
    assert np.square(x @ transform).sum() == pytest.approx(np.square(x).sum(), rel=1e-12)


@pytest.mark.parametrize("key", GRAPHS)
def test_every_window_is_predicted_by_itself(key: str) -> None:
    """No window's prediction depends on the others in its batch, nor on dropout once trained."""
    torch.manual_seed(0)
    architecture = GRAPHS[key]()
    network = build(key, architecture).double().eval()
    windows = torch.from_numpy(np.random.default_rng(4).standard_normal((6, architecture.history, 3)))
    with torch.no_grad():
        together, alone = network(windows), torch.cat([network(w[None]) for w in windows])
        hand = windows.clone()
        hand[:, -1, 1:] += 1
        assert (network(hand) - together).abs().max() > 1e-6
    torch.testing.assert_close(together, alone, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("key", GRAPHS)
def test_a_size_that_cannot_be_is_refused(key: str) -> None:
    with pytest.raises(ValueError, match="window is 1"):
        architecture_from(key, {"window": 1})
    with pytest.raises(ValueError, match="excitation is 1"):
        architecture_from(key, {"excitation": 1})
    with pytest.raises(ValueError, match="has no size 'colour'"):
        architecture_from(key, {"colour": 3})


@pytest.mark.parametrize(
    ("key", "sizes", "match"),
    [
        ("hapinf", {"d_model": 30}, "does not divide"),
        ("hapinf", {"n_start": 30}, "at most the window"),
        ("ldhtd", {"n_heads": 5}, "does not divide"),
        ("fnn", {"window": 90}, "expected 96 or more"),
        ("ten-mfcc", {"n_coefficients": 20}, "at most n_bands"),
        ("ten-wavelet", {"window": 12}, "expected 16 or more"),
        ("dstn", {"channels": 0}, "channels is 0"),
    ],
)
def test_what_does_not_fit_is_refused(key: str, sizes: dict[str, int], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        architecture_from(key, sizes)


def test_the_student_is_taught_half_by_its_teacher() -> None:
    rng = np.random.default_rng(5)
    samples = rng.standard_normal((400, 3))
    data = Data(samples, np.arange(20, 300), np.arange(320, 400), 20)
    taught = _taught(data, 20, TrainConfig(epochs=1, batch=64, threads=1, loss="mse"), lambda stage: None)
    assert taught.target is not None
    np.testing.assert_array_equal(taught.target[data.validation], samples[data.validation, 0])
    # A teacher that knows next to nothing of white noise predicts about zero, so the targets are about half.
    half = taught.target[data.train] / samples[data.train, 0]
    assert abs(np.median(half) - 0.5) < 0.1


def test_recipes_change_what_a_config_has() -> None:
    for key, changed in OWN_RECIPES.items():
        assert key in {*GRAPHS, "ten"}
        assert set(changed) <= set(vars(RECIPES["paper"]))


def test_an_excited_network_predicts_as_it_did() -> None:
    architecture = FnnArchitecture(excitation=True)
    torch.manual_seed(1)
    network = build("fnn", architecture)
    excited = Excited(network, architecture)
    windows = torch.randn(3, 144, 3)
    torch.testing.assert_close(excited(windows), network(windows))
    chance, tones = excited.rendered_power(torch.zeros(2, 2))
    torch.testing.assert_close(chance, excited.excitation(torch.zeros(2, 2)).double() ** 2)
    assert not tones.any()


def test_recurrent_layers_are_counted() -> None:
    """By hand: four gates over input and state for each sample, both ways, and a product for each of the last layer's inputs."""

    class Small(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layer = torch.nn.LSTM(3, 8, batch_first=True, bidirectional=True)
            self.out = torch.nn.Linear(16, 1)

        def forward(self, windows: torch.Tensor) -> torch.Tensor:
            return self.out(self.layer(windows)[0][:, -1])[:, 0]

    assert _multiply_adds(Small(), 40) == 40 * 2 * 4 * 8 * (3 + 8) + 16


@pytest.mark.parametrize("change", [{"batch": 2.5}, {"delta": float("inf")}, {"epochs": True}, {"seed": "1"}])
def test_a_setting_that_is_no_such_number_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(change))} is .*, expected a (whole|finite) number"):
        TrainConfig(**change)  # type: ignore[arg-type]


def test_an_interrupted_teacher_ends_the_training(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foten.train.train.fit", lambda *_: Progress(interrupted=True))
    data = Data(np.zeros((100, 3)), np.arange(20, 60), np.arange(60, 100), 20)
    with pytest.raises(KeyboardInterrupt):
        _taught(data, 20, TrainConfig(), lambda stage: None)
