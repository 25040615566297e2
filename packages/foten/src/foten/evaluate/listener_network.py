"""The listener: a small network that is trained to tell two vibrations apart, and scored on later excerpts.

Source: the classifier two-sample test (Lopez-Paz & Oquab, ICLR 2017).
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from foten.dsp import Array
from foten.dsp.distance import area_under_curve
from foten.dsp.level import N_BANDS

EXCERPT = 62  # frames of 8 ms: half a second
N_STEPS, BATCH = 500, 96  # the budget: four seconds on one core, seven with the waveform
RATE = 4e-3  # highest, of the learning
# Of a person: excerpts are learned by heart where their noise is larger than what tells them apart. With the rate above, level
# steps that are just noticeable were right in 0.64 of pairs in place of 0.75, with this one in 0.75.
PERSON_RATE = 1e-3
HOP = 15  # frames between the excerpts that are scored
N_SHOWN = 4  # times that each of them is shown to a person, who feels it anew each time


@dataclass(frozen=True)
class Limits:
    """A person's, for log energies re threshold: what is felt of them is standardised after the noise."""

    noise: float  # standard deviation of a band's own and of the common internal noise, in units of log energy
    mean: Array  # of what is felt without noise, shape (N_BANDS, 1)
    sd: Array


@dataclass(frozen=True)
class Vibration:
    """One of the two vibrations, cut into frames, and where its excerpts may begin."""

    frames: Array  # log energies, log speed and log force, shape (channels, n_frames); standardised, but for a person energies
    waveform: Array | None  # compressed, shape (n_frames, samples of a frame)
    train: NDArray[np.int64]  # numbers of the frames with which excerpts to learn from begin
    test: NDArray[np.int64]  # and those to be scored on
    limits: Limits | None = None  # of a person
    excerpt: int = EXCERPT  # frames


class Listener(nn.Module):
    """Log odds that an excerpt is of the second vibration."""

    def __init__(self, n_channels: int, frame: int | None, excerpt: int) -> None:
        """Listener of some channels, and of a waveform of so many samples a frame or none."""
        super().__init__()
        self.of_waveform = None
        if frame is not None:
            stride = max(1, frame // 2)
            self.of_waveform = nn.Sequential(
                nn.Conv1d(1, 32, 2 * frame, stride, padding=frame - stride // 2),
                nn.ReLU(),
                nn.Conv1d(32, 24, 4, 2, padding=1),
                nn.ReLU(),
                nn.AdaptiveAvgPool1d(excerpt),
            )
            n_channels += 24
        self.layers = nn.Sequential(
            *(nn.Conv1d(n_channels, 32, 5), nn.ReLU(), nn.Conv1d(32, 32, 5), nn.ReLU(), nn.AvgPool1d(2)),
            *(nn.Conv1d(32, 64, 5), nn.ReLU()),
        )
        self.out = nn.Linear(128, 1)

    def forward(self, frames: Tensor, waveform: Tensor | None) -> Tensor:
        """Log odds (b,): frames (b, channels, excerpt) and, where it takes them, waveforms (b, n)."""
        if self.of_waveform is not None and waveform is not None:
            frames = torch.cat([frames, self.of_waveform(waveform[:, None])], dim=1)
        over_time = self.layers(frames)
        return self.out(torch.cat([over_time.mean(dim=2), over_time.amax(dim=2)], dim=1))[:, 0]


def listener_auc(first: Vibration, second: Vibration, seed: int, same_stroke: bool = True) -> float:
    """Area under the curve of a listener that is trained on two vibrations for a fixed budget, on one core.

    Of two under the same stroke it is shown the same moments, so that speed and force say nothing.
    """
    n_threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the layers are too small for more, and the sums are the same on every machine
    try:
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            return _listener_auc((first, second), np.random.default_rng(seed), same_stroke)
    finally:
        torch.set_num_threads(n_threads)


def _listener_auc(both: tuple[Vibration, Vibration], rng: np.random.Generator, same_stroke: bool) -> float:
    frames = [torch.from_numpy(each.frames).float() for each in both]
    waveforms = [None if each.waveform is None else torch.from_numpy(each.waveform).float() for each in both]
    frame = None if waveforms[0] is None else waveforms[0].shape[1]
    offsets, limits = torch.arange(both[0].excerpt), both[0].limits

    def excerpts(which: int, starts: NDArray[np.int64]) -> tuple[Tensor, Tensor | None]:
        at = torch.from_numpy(starts)[:, None] + offsets
        shown, samples = frames[which][:, at].transpose(0, 1), waveforms[which]
        if limits is not None:
            shown = torch.cat([felt(shown[:, :N_BANDS], limits), shown[:, N_BANDS:]], dim=1)
        return shown, None if samples is None else samples[at].flatten(1)

    listener = Listener(len(frames[0]), frame, both[0].excerpt)
    rate = RATE if limits is None else PERSON_RATE
    optimiser = torch.optim.AdamW(listener.parameters(), rate, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=N_STEPS)
    half = BATCH // 2
    known = torch.arange(2).repeat_interleave(half).float()
    for _ in range(N_STEPS):
        starts = [rng.choice(each.train, half) for each in both]
        if same_stroke:
            starts[1] = both[1].train[np.searchsorted(both[0].train, starts[0])]
        (x, w), (y, u) = (excerpts(k, start) for k, start in enumerate(starts))
        odds = listener(torch.cat([x, y]), None if w is None or u is None else torch.cat([w, u]))
        loss = functional.binary_cross_entropy_with_logits(odds, known)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    listener.eval()
    with torch.no_grad():
        n_shown = 1 if limits is None else N_SHOWN
        odds_of = [listener(*excerpts(k, np.tile(each.test, n_shown))).double().numpy() for k, each in enumerate(both)]
    return area_under_curve(*odds_of)


def felt(levels: Tensor, limits: Limits) -> Tensor:
    """What a person feels of excerpts, standardised: log energies re threshold (b, N_BANDS, EXCERPT), drawn anew in each call.

    The noise moves all frames of an excerpt alike. What is below threshold has a draw of its own: otherwise silent frames would
    give away how far the others were moved.
    """
    own, common = torch.randn(2, len(levels), N_BANDS, 1), torch.randn(2, len(levels), 1, 1)
    of_energy, of_threshold = limits.noise * (own + common)
    mean, sd = (torch.from_numpy(each).float() for each in (limits.mean, limits.sd))
    return (torch.logaddexp(levels + of_energy, of_threshold) - mean) / sd
