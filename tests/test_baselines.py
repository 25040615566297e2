"""The systems that foten is compared with: their fixed parts do what they are named for, and their targets are what is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.fft import dct
from scipy.signal import welch

from foten.models.graph import multiply_adds
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.training.checkpoint import Checkpoint, Epoch, Progress
from foten.training.config import WindowConfig
from foten.training.job import ScaledBlocks, scaled_blocks
from foten.training.loop import Monitor
from foten.training.window_fit import TrainingWindows, fit_windows
from foten_lab.baselines.fit import distilled, log_spectra
from foten_lab.baselines.fnn import EDGES, lagged_bands
from foten_lab.baselines.gan import Gan, fit_adversarial
from foten_lab.baselines.networks import build
from foten_lab.baselines.noise_filter import NoiseFilter, log_magnitudes
from foten_lab.baselines.sizes import BASELINES, DftnetSizes, GanSizes, TenMfccSizes, TenWaveletSizes
from foten_lab.baselines.ten_variants import MfccBranch, WaveletBranch, cosine_transform, mel_bands, wavelet_transform


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
    branch = MfccBranch(TenMfccSizes(n_bands=6, n_coefficients=6))
    x = torch.from_numpy(np.random.default_rng(2).standard_normal((4, 30)))
    louder = (branch(2 * x) - branch(x)).numpy()
    np.testing.assert_allclose(louder[:, 0], np.sqrt(6) * np.log(4), rtol=1e-3)
    np.testing.assert_allclose(louder[:, 1:], 0, atol=2e-3)


def test_wavelets_keep_what_is_smooth_out_of_the_details() -> None:
    """Two vanishing moments: a straight line has no details but at the mirrored beginning; energy inside is kept."""
    transform = wavelet_transform(64, 3)
    assert transform.shape[1] == WaveletBranch(TenWaveletSizes(window=64)).n_out
    line = np.linspace(-1, 2, 64)
    details = line @ transform[:, :32]
    assert np.abs(details[:-2]).max() < 1e-12
    x = np.zeros(64)
    x[30:50] = np.random.default_rng(3).standard_normal(20)
    assert np.square(x @ transform).sum() == pytest.approx(np.square(x).sum(), rel=1e-12)


@pytest.mark.parametrize("model", ["ten-mfcc", "ten-wavelet"])
def test_coefficients_pass_an_encoder_layer_as_the_magnitude_does(model: str) -> None:
    """Else rows of Table II would differ by layers: wavelet coefficients were a linear function of the window."""
    torch.manual_seed(0)
    branch = build(BASELINES[model].sizes()).double().eval().spectral
    magnitude = build(BASELINES["foten-d"].sizes()).spectral.get_submodule("magnitude_layer")
    assert {n: p.shape for n, p in branch.layer.named_parameters()} == {
        n: p.shape for n, p in magnitude.named_parameters()
    }
    x = torch.from_numpy(np.random.default_rng(6).standard_normal((4, 30)))
    with torch.no_grad():
        both, apart = branch(x[:2] + x[2:]), branch(x[:2]) + branch(x[2:]) - branch(torch.zeros(2, 30).double())
    assert (both - apart).abs().max() > 0.01


@pytest.mark.parametrize("model", BASELINES)
def test_every_window_is_predicted_by_itself(model: str) -> None:
    """No window's prediction depends on the others in its batch, nor on dropout once trained."""
    torch.manual_seed(0)
    sizes = BASELINES[model].sizes()
    network = build(sizes).double().eval()
    # Nothing that its sizes give is stored.
    assert network.state_dict().keys() == dict(network.named_parameters()).keys()
    windows = torch.from_numpy(np.random.default_rng(4).standard_normal((6, sizes.history, 3)))
    with torch.no_grad():
        at_once, alone = network(windows), torch.cat([network(w[None]) for w in windows])
        hand = windows.clone()
        hand[:, -1, 1:] += 1
        assert (network(hand) - at_once).abs().max() > 1e-6
    torch.testing.assert_close(at_once, alone, rtol=1e-9, atol=1e-12)


def test_the_student_learns_half_from_its_teacher() -> None:
    rng = np.random.default_rng(5)
    samples = rng.standard_normal((400, 3))
    windows = TrainingWindows(samples, np.arange(20, 300), np.arange(320, 400), 20)
    config = WindowConfig(epochs=1, batch=64, threads=1, loss="mse")
    target = distilled(windows, 20, config, Monitor())[0].target
    assert target is not None
    np.testing.assert_array_equal(target[windows.validation], samples[windows.validation, 0])
    # A teacher that knows next to nothing of white noise predicts about zero, so the targets are about half.
    half = target[windows.train] / samples[windows.train, 0]
    assert abs(np.median(half) - 0.5) < 0.1


def test_recurrent_layers_are_counted() -> None:
    """By hand: four gates over input and state for each sample, both ways, and a product for each of the last layer's inputs."""

    class Small(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layer = torch.nn.LSTM(3, 8, batch_first=True, bidirectional=True)
            self.out = torch.nn.Linear(16, 1)

        def forward(self, windows: torch.Tensor) -> torch.Tensor:
            return self.out(self.layer(windows)[0][:, -1])[:, 0]

    assert multiply_adds(Small(), 40) == 40 * 2 * 4 * 8 * (3 + 8) + 16


def test_an_interrupted_teacher_ends_the_training(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foten_lab.baselines.fit.fit_windows", lambda *_: Progress(interrupted=True))
    windows = TrainingWindows(np.zeros((100, 3)), np.arange(20, 60), np.arange(60, 100), 20)
    with pytest.raises(KeyboardInterrupt):
        distilled(windows, 20, WindowConfig(), Monitor())


@pytest.mark.parametrize(("n", "level"), [(15, 3.5), (16, -4.0), (16, 3.5), (64, 0.0)])
def test_filtered_noise_has_the_logarithms_that_are_asked_for(n: int, level: float) -> None:
    """White noise and those of a smooth spectrum: means over 20,000 frames, at both ends as between.

    However loud. At zero and at half of the rate a spectrum has no imaginary part, and the mean logarithm of a smooth one lies
    log 2 / 2 lower.
    """
    torch.manual_seed(3)
    bins = torch.arange(n // 2 + 1, dtype=torch.float64)
    # A filter with three taps, which a Hann window hardly blurs.
    asked = 0.3 * torch.cos(2 * torch.pi * bins / n) + level
    asked[(bins == 0) | (2 * bins == n)] -= 0.5 * np.log(2)
    noise = torch.randn(20_000, 2 * n - 1, dtype=torch.float64)
    logs = log_magnitudes(NoiseFilter(n).double()(noise.unfold(1, n, 1), asked)).mean(0)
    # The last bin of an odd frame lies half of one below half of the rate, and is a little of either kind.
    compared = slice(None) if n % 2 == 0 else slice(-1)
    torch.testing.assert_close(logs[compared], asked[compared], rtol=0, atol=0.03)


def test_a_generator_plays_sample_by_sample_what_it_was_judged_by() -> None:
    """A spectrum that stands still for a stride: its first sample is that of the rendering, the others nearly."""
    torch.manual_seed(4)
    sizes = GanSizes()
    network, m = build(sizes).double(), sizes.window
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.05 * torch.randn_like(parameter)
        noise = torch.randn(2, m + 40, 1, dtype=torch.float64)
        hand = torch.linspace(-1, 1, m + 40, dtype=torch.float64)[None, :, None].expand(2, -1, 2)
        windows = torch.cat([noise, hand], dim=2)
        at_once = network.played(windows)
        one_by_one = torch.stack([network(windows[:, i : i + m]) for i in range(40)], dim=1)
    assert at_once.shape == one_by_one.shape
    torch.testing.assert_close(at_once[:, ::8], one_by_one[:, ::8])
    assert (at_once - one_by_one).abs().mean() < 0.1 * one_by_one.abs().mean()
    assert (at_once != one_by_one).any()


def test_targets_of_spectra_are_frames_around_a_sample() -> None:
    assert log_magnitudes(torch.zeros(16)).exp().tolist() == pytest.approx([1e-4] * 9)  # of silence
    blocks = noise_blocks(n_blocks=5, block=200)
    # The first there is.
    assert 76 in log_spectra(TrainingWindows(blocks.flat, *blocks.targets(76), 76), blocks).train % 200
    windows = TrainingWindows(blocks.flat, *blocks.targets(40), 40)
    framed = log_spectra(windows, blocks)
    assert framed.target is not None
    assert 0 < len(framed.train) < len(windows.train)
    for n in (framed.train, framed.validation):
        assert (n % 200 + 20 <= 200).all()
        around = torch.from_numpy(windows.samples[n[1] - 20 : n[1] + 20, 0])
        np.testing.assert_allclose(framed.target[n[1]], log_magnitudes(around), atol=1e-5)


def test_spectra_follow_the_hand() -> None:
    """Noise as loud as the hand is fast: the model of spectra is, on a trace that it was not trained on."""
    blocks = noise_blocks(n_blocks=40, block=200)
    windows = TrainingWindows(blocks.flat, *blocks.targets(40), 40)
    torch.manual_seed(0)
    network = build(DftnetSizes(window=40, n_conditions=4, first=16, second=16, third=16))
    before = network.spectrum(torch.zeros(1, 40, 3)).detach()
    config = WindowConfig(epochs=12, patience=12, batch=32, threads=1, loss="mse", learning_rate=3e-3)
    fit_windows(network.spectrum, log_spectra(windows, blocks), config, Monitor())
    hand = torch.zeros(2, 40, 3)
    hand[0, :, 1], hand[1, :, 1] = -1.0, 1.0
    with torch.no_grad():
        slow, fast = network.spectrum(hand)
    assert not torch.equal(before[0], slow)
    # Speeds of one standard deviation below and above the mean, as loud as these are fast.
    mean, sd = blocks.scaling.mean[1], blocks.scaling.sd[1]
    assert float((fast - slow)[2:-2].mean()) == pytest.approx(np.log((mean + sd) / (mean - sd)), abs=0.25)


def small_gan() -> Gan:
    torch.manual_seed(1)
    return Gan(GanSizes(window=42, frame=16, stride=1, channels=4))


def test_an_adversarial_training_goes_on_where_it_stopped(tmp_path: Path) -> None:
    """Discriminator and optimiser in the checkpoint; the crops, the noise and the loss are those of each epoch."""
    blocks, path = noise_blocks(n_blocks=5, block=200), tmp_path / "checkpoint.pt"
    config = WindowConfig(epochs=3, batch=2, threads=1, learning_rate=1e-3)

    def fitted(seed: int, monitor: Monitor) -> tuple[Gan, Progress]:
        network = small_gan()
        torch.manual_seed(seed)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("foten_lab.baselines.gan.STEPS", 10)
            progress = fit_adversarial(network, 42, blocks, config, monitor)
        return network, progress

    def stop(line: Epoch) -> None:
        if line.epoch == 2:
            raise KeyboardInterrupt

    uninterrupted, expected = fitted(2, Monitor())
    assert fitted(2, Monitor(on_epoch=stop, checkpoint=Checkpoint(path, config)))[1].interrupted
    resumed, log = fitted(5, Monitor(checkpoint=Checkpoint(path, config, resume=True)))
    assert [line.validation_loss for line in log.epochs] == [line.validation_loss for line in expected.epochs]
    for name, tensor in uninterrupted.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name
    assert expected.epochs[-1].validation_loss != expected.epochs[0].validation_loss


def test_blocks_too_short_for_spectrograms_are_refused() -> None:
    blocks = noise_blocks(n_blocks=5, block=60)
    with pytest.raises(ValueError, match="expected 65 or more: use a longer --block"):
        fit_adversarial(small_gan(), 42, blocks, WindowConfig(epochs=1, threads=1), Monitor())


def noise_blocks(n_blocks: int, block: int) -> ScaledBlocks:
    """White noise as loud as a hand is fast, which moves by chance from block to block."""
    rng = np.random.default_rng(6)
    speed = np.repeat(rng.uniform(40, 200, n_blocks), block)
    trace = Trace(
        acceleration=0.01 * speed * rng.standard_normal(speed.size),
        speed=speed,
        force=np.full(speed.size, 1.0) + rng.uniform(0, 0.1, speed.size),
        rate_hz=1000.0,
        block=block,
    )
    split = Split(tuple(range(n_blocks - 2)), (n_blocks - 2,), (n_blocks - 1,), n_blocks, block, "regrouped", 0)
    return scaled_blocks(trace, split)
