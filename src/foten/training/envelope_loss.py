"""How unlike a hand would find two drawn vibrations and a recorded one: statistics of band envelopes, as a loss with a gradient.

Half a second is described by what `dsp.bands` keeps of it, log energies in eight bands and frames of 8 ms: of each band the mean,
the deviation, the asymmetry and how it goes on over 8 to 96 ms; of each pair the correlation, and which of the two leads. What a
texture's sound is told by are such statistics, and they are what a likelihood of single samples has no eye for: a network that
takes its own loud samples for the beginning of a burst is hardly less likely for it, and all its bands rise and fall as one.

A model that is to draw *all* that a surface may do under a hand, and nothing else, is scored by the energy distance: with y
recorded and x, x' two renderings under its hand,

    E |x − y| − ½ E |x − x'|

is smallest where x is distributed as y is, given the hand, and for no other distribution. Of each statistic by itself (which is
the continuous ranked probability score), and of short stretches of all bands at once. Frames at rest do not count: a rendering is
silent there by rule, and a sensor is not.

Source: McDermott & Simoncelli, "Sound texture perception via statistics of the auditory periphery" (Neuron 2011), for the
statistics; Gneiting & Raftery, "Strictly proper scoring rules" (JASA 2007), for the score.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from foten.dsp import Array
from foten.dsp.bands import BAND_FRAME_MS, N_BANDS, envelope_edges

LAGS = (1, 2, 3, 4, 6, 8, 12)  # frames over which a band may go on
POOLED = (1, 2, 4, 8, 16, 32)  # frames of a stretch of all bands
STRETCH_WEIGHT = 0.3  # weight of these beside the statistics
FLOOR = 1e-4  # of the mean energy of a band, as a listener's
MIN_FRAMES = 8  # of a stroke in an excerpt, for its statistics to be any
_MIN_VARIANCE, _MIN_SQUARE = 1e-3, 1e-4


@lru_cache(maxsize=4)
def _responses(n: int, rate_hz: float) -> Tensor:
    """The band-passes of `dsp.bands` at the frequencies of a transform of n samples, (N_BANDS, n // 2 + 1)."""
    from scipy.signal import butter, sosfreqz

    frequencies = np.fft.rfftfreq(n, 1 / rate_hz)
    passes = [
        sosfreqz(butter(2, edges, "bandpass", fs=rate_hz, output="sos"), frequencies, fs=rate_hz)[1]
        for edges in pairwise(envelope_edges(rate_hz))
    ]
    return torch.from_numpy(np.stack(passes)).to(torch.complex64)


def energies(signals: Tensor, rate_hz: float) -> Tensor:
    """What `dsp.bands.band_energies` does, but for what rings on: signals (…, n) → (…, N_BANDS, n_frames)."""
    n, frame = signals.shape[-1], round(BAND_FRAME_MS * rate_hz / 1000)
    length = n + round(0.25 * rate_hz)  # in which the lowest band rings out, and does not come round
    spectra = torch.fft.rfft(signals, length)[..., None, :] * _responses(length, rate_hz)
    bands = torch.fft.irfft(spectra, length)[..., : n // frame * frame]
    return bands.reshape(*bands.shape[:-1], n // frame, frame).square().mean(dim=-1)


class EnvelopeEnergyDistance:
    """A loss of renderings against what was recorded, in units of how much recorded excerpts vary."""

    def __init__(self, recorded: Array, moving: NDArray[np.bool_], rate_hz: float) -> None:
        """Make one for recorded excerpts (k, n), scaled, many enough for statistics to vary, whose frames move or rest (k, f)."""
        self._rate_hz = rate_hz
        known, counted = energies(torch.from_numpy(recorded).float(), rate_hz), torch.from_numpy(moving)
        of_strokes = known.transpose(1, 2)[counted] if counted.any() else known.transpose(1, 2).flatten(0, 1)
        self._floor = FLOOR * of_strokes.mean(dim=0)[:, None] + torch.finfo(torch.float32).tiny
        logs = torch.log(of_strokes.T + self._floor)
        self._mean, self._sd = logs.mean(dim=1)[:, None], logs.std(dim=1)[:, None].clamp_min(1e-6)
        self._unit = self._statistics(known, counted).std(dim=0).clamp_min(1e-6)

    def __call__(self, drawn: Tensor, recorded: Tensor, prefix: Tensor, moving: Tensor) -> Tensor:
        """The loss of two renderings each (2, k, n) of excerpts (k, n), both after what was recorded before (k, m).

        Args:
            moving: the frames of the excerpts that are of a stroke, (k, f).
        """
        n_before = prefix.shape[-1] // round(BAND_FRAME_MS * self._rate_hz / 1000)
        first, second, truth = (
            energies(torch.cat([prefix, signal], dim=-1), self._rate_hz)[..., n_before:]
            for signal in (*drawn, recorded)
        )
        of_statistics = [self._statistics(energy, moving) / self._unit for energy in (first, second, truth)]
        loss = _energy_distance(*(statistics[..., None] for statistics in of_statistics))
        stretches = zip(*(self._stretches(energy, moving) for energy in (first, second, truth)), strict=True)
        return loss + STRETCH_WEIGHT * torch.stack([_energy_distance(*stretch) for stretch in stretches]).mean()

    def _statistics(self, energy: Tensor, moving: Tensor) -> Tensor:
        """What describes excerpts (k, N_BANDS, f) whose frames move or rest (k, f): (k, n_statistics).

        All zero where an excerpt is too short.
        """
        counts = moving[:, None].float()
        logs = counts * (torch.log(energy + self._floor) - self._mean) / self._sd
        n = counts.sum(dim=-1).clamp_min(1)
        mean = logs.sum(dim=-1) / n
        off = counts * (logs - mean[..., None])
        variance = off.square().sum(dim=-1) / n + _MIN_VARIANCE
        sd = variance.sqrt()

        def pairs(lag: int) -> Tensor:
            return (counts[..., lag:] * counts[..., :-lag]).sum(dim=-1).clamp_min(1)

        autocorrelation = [
            (off[..., lag:] * off[..., :-lag]).sum(dim=-1) / pairs(lag) / variance
            for lag in LAGS
            if lag < off.shape[-1]
        ]
        unit = off / sd[..., None]
        row, column = np.triu_indices(N_BANDS, 1)
        correlation = unit @ unit.transpose(-1, -2) / n[..., None]
        later = unit[..., 1:] @ unit[..., :-1].transpose(-1, -2) / pairs(1)[..., None]
        lag_difference = later - later.transpose(-1, -2)
        asymmetry = unit.pow(3).sum(dim=-1) / n
        described = torch.cat(
            [mean, sd, *autocorrelation, asymmetry, correlation[..., row, column], lag_difference[..., row, column]],
            dim=-1,
        )
        return described * (n >= MIN_FRAMES)

    def _stretches(self, energy: Tensor, moving: Tensor) -> list[Tensor]:
        """Log energies of all bands over two stretches in a row, for stretches of several lengths: (k, any, 2 N_BANDS).

        Zero where all of a stretch is at rest.
        """
        parts = []
        counts = moving[:, None].float()
        for length in POOLED:
            n = energy.shape[-1] // length
            if n < 2:
                break
            pooled, counted = (
                values[..., : n * length].unflatten(-1, (n, length)).sum(dim=-1) for values in (counts * energy, counts)
            )
            logs = torch.log(pooled / counted.clamp_min(1) + self._floor) / self._sd * (counted > 0)
            parts.append(torch.cat([logs[..., :-1], logs[..., 1:]], dim=-2).transpose(-1, -2))
        return parts


def _energy_distance(first: Tensor, second: Tensor, recorded: Tensor) -> Tensor:
    """The mean of |x − y| − ½ |x − x'| over vectors along the last axis, equal shapes."""

    def distance(a: Tensor, b: Tensor) -> Tensor:
        if a.shape[-1] == 1:
            return (a - b).abs().mean()
        return (a - b).square().sum(dim=-1).add(_MIN_SQUARE).sqrt().mean()

    return 0.5 * (distance(first, recorded) + distance(second, recorded) - distance(first, second))
