"""`foten train`: train a texture file on a recording."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Exit, Option

from foten.cli.evaluate import network_summary, random_part_summary, validation_summary
from foten.console import JsonOption, check_files, options_from, preload, print_result, refuse
from foten.models.trainable import recipe_of, trainable, trainable_sizes
from foten.models.trainable import train as train_texture
from foten.training.config import FILTERS, LoopConfig, TrainConfig

if TYPE_CHECKING:
    from foten.recording.inspection.values import Inspection
    from foten.recording.recording import Recording
    from foten.training.job import Trained, TrainingJob
    from foten.training.run_folder import RunFolder, TrainingDisplay

GO_ON = "the same command with --resume, which continues from here"

Anyway = Annotated[
    bool, Option("--anyway", help="Continue even if nothing sensible can be learned from the recording.")
]


def _of(name: str) -> str:
    """Default of a setting for help: ours, and the paper's where it differs."""
    ours, paper = (getattr(recipe_of("foten", recipe), name) for recipe in FILTERS)
    return f"{ours}" if ours == paper else f"{ours}; paper {paper}"


@dataclass(frozen=True)
class TrainOptions:
    """Options of `foten train`; None is the recipe's, or the model's."""

    recording_files: list[Path] = Argument(
        ..., metavar="REC.h5…", help="Recordings written by 'foten import'; several are takes of the same surface."
    )
    output: Path = Option(..., "-o", "--output", metavar="T.foten", help="Texture file to write (.foten).")
    model: str = Option(
        "foten-plus",
        help="Model: foten-plus (ours), foten (the paper's), its variants ten, ten-mfcc, ten-wavelet, foten-d, or a "
        "re-implemented system: ar (piecewise AR), fnn, dstn, hapinf, ldhtd, dftnet, gan.",
    )
    recipe: str = Option(
        "default",
        help="Training settings: default (ours) or paper (Sec. IV-e, low-pass of 25 Hz; not for foten-plus and gan).",
    )
    rate: float | None = Option(
        None, help="Sampling rate of the model (Hz), at most that of the recorded acceleration.", show_default="1000"
    )
    trim: float | None = Option(
        None,
        help="Time discarded at both ends of the recording (ms).",
        show_default="2000, or less to fit a short recording",
    )
    block: float | None = Option(
        None,
        help="Length of the blocks that are split into training, validation and test (ms).",
        show_default="2000, or less to fit a short recording",
    )
    window: int | None = Option(
        None,
        help="Number of past samples that the network predicts from.",
        show_default="foten, foten-d, hapinf, ldhtd: 20; ten: 25; ten-mfcc, ten-wavelet: 30; foten-plus, dstn: 40; dftnet: 100; "
        "fnn: 144; gan: 272",
    )
    seed: int = Option(
        0, min=0, max=2**32 - 1, help="Seed of the initial weights, the order of training windows and dropout."
    )
    split: str = Option(
        "regrouped", help="How blocks are split: regrouped (by speed and force) or contiguous (in time)."
    )
    split_seed: int = Option(0, min=0, help="Seed of the regrouped split.")
    epochs: int | None = Option(
        None, help="Maximum number of epochs; by default the recipe's. An epoch of foten-plus is 100 steps, of gan 50."
    )
    loss: str | None = Option(
        None, help="Training loss: huber, mse or mae; foten-plus uses a likelihood instead.", show_default=_of("loss")
    )
    delta: float | None = Option(
        None, help="Threshold of the Huber loss, in scaled (standardised) acceleration.", show_default=_of("delta")
    )
    batch: int | None = Option(None, help="Windows (foten-plus: chunks) per training step; by default the recipe's.")
    learning_rate: float | None = Option(None, help="Highest learning rate of the schedule; by default the recipe's.")
    dropout: float | None = Option(
        None, help="Share of hidden values that dropout sets to zero.", show_default=_of("dropout")
    )
    initial_weights: str | None = Option(
        None,
        help="Initial weights: uniform (as in PyTorch) or glorot (as in Keras).",
        show_default=_of("initial_weights"),
    )
    recorded_innovations: str | None = Option(
        None,
        help="Whether the file may hold the recording's innovations, from which the recording can nearly be restored: auto "
        "(where noise is told from the recording, but not of a microphone above 2 kHz, which hears speech), always (of a "
        "microphone too) or never.",
        show_default="auto; foten-plus only",
    )
    excitation: bool = Option(
        False, "--excitation", help="Add a random excitation, without which a network's free run falls silent."
    )
    settings: list[str] | None = Option(
        None,
        "--set",
        metavar="SIZE=VALUE",
        help="Change a size or variant of the network, e.g. n_layers=2; repeatable. foten-plus: n_hidden, head_width, "
        "n_components; foten: d_model, n_heads, n_layers, d_feedforward, head=[256,64], spectral_width (1 as "
        "printed in the paper), pre_norm=false, bins=half.",
    )
    zero_phase: bool = Option(
        False,
        "--zero-phase",
        help="Filter the recording forwards and backwards (zero phase), which a live filter cannot do.",
    )
    force_units: bool = Option(False, "--force-units", help="Accept values above 5 m/s, 1000 m/s² or 500 N.")
    anyway: Anyway = False
    resume: bool = Option(False, "--resume", help="Continue from the checkpoint in the run folder.")
    run_folder: Path | None = Option(
        None, "--run", metavar="DIR", help="Run folder, for log, curves and checkpoint.", show_default="T.run"
    )
    texture: str = Option("", help="Name of the texture in the file's card; by default the recording's.")
    licence: str = Option("", help="Licence of the texture, preferably an SPDX identifier: CC-BY-4.0, CC0-1.0, …")
    author: str = Option("", help="Author to credit in the file's card.")
    source: str = Option("", help="Origin of the recording for the file's card: a dataset or a link.")
    doi: str = Option("", help="DOI of the recording or its paper, e.g. 10.6084/m9.figshare.29438288.")
    photo: str = Option("", help="Credit and licence of the photograph that lies beside the file.")
    threads: int | None = Option(
        None,
        help="Number of CPU threads that share each batch; a GPU takes the whole batch.",
        show_default=_of("threads"),
    )
    as_json: JsonOption = False

    def __post_init__(self) -> None:
        trainable(self.model)
        if self.output.suffix != ".foten":
            raise ValueError(f"a texture file is written as .foten, got -o {self.output.name}")
        check_files([self.output, self.run_folder or self.output])
        of_networks = self.changes() | {"window": self.window, "set": self.settings, "run": self.run_folder}
        of_networks |= {"resume": self.resume, "seed": self.seed or None, "excitation": self.excitation}
        if not self.has_network:
            refuse("is for networks, and --model ar is none", **of_networks, recipe=self.recipe != "default")
        if self.of_spectra:
            of_noise = f"is for models that predict samples, and {self.model} filters noise"
            refuse(of_noise, excitation=self.excitation)
        if self.doi and not re.fullmatch(r"10\.\d{4,9}/\S+", self.doi):
            raise ValueError(f"--doi is {self.doi!r}, expected 10.NUMBER/NAME, without https://doi.org/")
        if self.split == "contiguous":
            refuse("is for the regrouped split, and --split is contiguous", split_seed=self.split_seed or None)
        self.config()

    @property
    def has_network(self) -> bool:
        """Whether there is a run folder, with a log and a checkpoint."""
        return trainable(self.model).has_network

    @property
    def of_spectra(self) -> bool:
        """Whether the model is fitted to spectra, and not to samples."""
        return not trainable(self.model).sizes.predicts_samples

    def changes(self) -> dict[str, Any]:
        """Settings of `TrainConfig` that differ from the recipe's, by name."""
        of_networks = ("epochs", "loss", "delta", "batch", "learning_rate", "dropout", "initial_weights", "threads")
        names = (*of_networks, "recorded_innovations")
        return _not_none(**{name: getattr(self, name) for name in names})

    def config(self) -> TrainConfig:
        """The recipe with the changes."""
        changes = self.changes() | ({"seed": self.seed} if self.has_network else {})
        return recipe_of(self.model, self.recipe, **changes)

    def job(self, recording: Recording) -> TrainingJob:
        """Training job of a recording."""
        from foten.recording.preprocess import PreprocessConfig, fitting_cut
        from foten.training.job import TrainingJob, shortest_block

        sizes = _not_none(window=self.window) | _settings(self.settings or [])
        sizes |= {"excitation": True} if self.excitation else {}
        trained_sizes = trainable_sizes(self.model, sizes)
        trim_ms, block_ms = self.trim, self.block
        if self.recipe != "paper":
            rate_hz = self.rate or PreprocessConfig().rate_hz
            fitting = fitting_cut(recording, 1000 * shortest_block(trained_sizes.window) / rate_hz)
            trim_ms = fitting[0] if trim_ms is None else trim_ms
            block_ms = fitting[1] if block_ms is None else block_ms
        cut = _not_none(rate_hz=self.rate, trim_ms=trim_ms, block_ms=block_ms) | FILTERS[self.recipe]
        preprocess = PreprocessConfig(zero_phase=self.zero_phase, force_units=self.force_units, **cut)
        if "excitation_width" in sizes and not trained_sizes.excited:
            none = "excitation_width is for an excitation, and there is none"
            raise ValueError(f"{none}: leave it out, or add --excitation")
        texture, config = self.texture or recording.texture, self.config()
        of_split = self.split, self.split_seed
        credit = {"authors": self.author, "source": self.source, "doi": self.doi, "photo": self.photo}
        credit = {key: text for key, text in credit.items() if text}
        about = recording, self.model, trained_sizes, config, preprocess
        return TrainingJob(*about, *of_split, texture, self.licence, credit)


@options_from(TrainOptions)
def train(options: TrainOptions) -> None:
    """Train a texture on a recording. Ctrl-C stops it and keeps the best model so far."""
    from foten.datasets.hdf5 import load_takes
    from foten.models.texture_file import write_texture
    from foten.recording.inspection import inspect_recording

    output, config = options.output, options.config()
    preload(["scipy.signal", "torch"], options.recording_files)
    recording = load_takes(options.recording_files)
    job = options.job(recording)
    inspection = inspect_recording(recording, is_trained=True)
    if not options.anyway:
        check_usable(unusable(inspection, besides=("refused", "short")))  # which the training says itself
    from foten.training.run_folder import RunFolder, TrainingDisplay

    n_epochs, unit = (config.epochs if isinstance(config, LoopConfig) else 0), "nat" if options.of_spectra else "sd"
    display = TrainingDisplay(n_epochs, unit)
    folder = RunFolder(options.run_folder or output.with_suffix(".run"), display.note)
    if options.has_network:
        folder.open(_settled(job), options.resume)
    with display:
        trained = _shown(job, list(_notes(inspection, job.preprocess.rate_hz)), options, folder, display)
    write_texture(trained.texture, output)
    outputs = str(output)
    if options.has_network:
        folder.close(trained)
        outputs += f" and {folder.path}"
    following = f"foten evaluate {output} {' '.join(map(str, options.recording_files))}"
    if trained.progress.interrupted and folder.checkpoint.exists():
        following = GO_ON
    text = f"{_summary(trained)}\nwrote {outputs}; next: {following}"
    print_result({"output": str(output), **_document(trained)}, text, options.as_json)
    if trained.progress.interrupted:
        raise Exit(130)


def _shown(
    job: TrainingJob, notes: list[str], options: TrainOptions, folder: RunFolder, display: TrainingDisplay
) -> Trained:
    """Result of a training that is shown and logged as it goes, with notes on its recording."""
    from foten.models.texture_file import Texture, write_texture
    from foten.training.checkpoint import Checkpoint, Epoch
    from foten.training.loop import Monitor

    early = [f"wrote {options.output}: playable already; training will replace it"]

    def on_playable(playable: Texture) -> None:
        write_texture(playable, options.output)
        while early:  # another linear model may be nearer
            display.note(early.pop())

    def on_epoch(epoch: Epoch) -> None:
        while notes:  # once the recording was taken: a refusal is one line
            display.note(notes.pop(0))
        display.show(epoch)
        folder.log(epoch)

    checkpoint = Checkpoint(folder.checkpoint, job.config, options.resume)
    try:
        trained = train_texture(job, Monitor(display.stage, on_epoch, on_playable, checkpoint))
    except KeyboardInterrupt:  # before there was a network to write
        if folder.checkpoint.exists():
            display.note(f"next: {GO_ON}")
        raise
    for note in (*notes, *trained.progress.notes):
        display.note(note)
    return trained


def _settled(job: TrainingJob) -> dict[str, Any]:
    """Settings that a checkpoint's run and the one that resumes it share."""
    return {
        "model": job.model,
        "train": asdict(job.config),
        "preprocess": asdict(job.preprocess),
        "sizes": job.sizes.to_card(),
        "split": job.split_method,
        "split_seed": job.split_seed,
        "recording_sha256": job.recording.sha256(),
    }


def _not_none(**options: Any) -> dict[str, Any]:
    """Options that are set, by name."""
    return {name: value for name, value in options.items() if value is not None}


def _document(trained: Trained) -> dict[str, Any]:
    texture, trace = trained.texture, trained.trace
    return {
        "sha256": texture.sha256(),
        "interrupted": trained.progress.interrupted,
        "n_blocks": trace.n_blocks,
        "n_samples_dropped": trace.n_dropped,
        "n_samples_uncovered": trace.n_uncovered,
        "split_sha256": texture.card["split_sha256"],
        "extrapolation_exponents": texture.card["extrapolation_exponents"],
        **texture.card["metrics"],
    }


def _summary(trained: Trained) -> str:
    """Result of a training, in lines."""
    from foten.recording.preprocess import cut_in_words
    from foten.recording.recording import counted

    card, trace = trained.texture.card, trained.trace
    metrics, sizes, condition = card["metrics"], card["sizes"], card["warm_start"]["recorded"]
    summary, origin = f"validation blocks: {validation_summary(card)}", "recorded"
    if "n_pieces" in metrics:
        summary += f", order {sizes['order']}, {sizes['n_models']} models from {metrics['n_pieces']} segments"
        summary += ", including those around the trained range"
        if metrics["n_pieces_left_out"]:
            summary += f", {counted(metrics['n_pieces_left_out'], 'segment')} without vibration left out"
        origin = "modelled"
    else:
        summary += f" (epoch {metrics['best_epoch']})"
    if metrics.get("validation_mae_scaled_lattice") is not None:
        summary += f", {metrics['validation_mae_scaled_lattice']:.4f} sd without the network"
    lines = [summary]
    takes = f"{len(trace.take_blocks)} takes, " if trace.take_blocks else ""
    trim_ms, block_ms = trace.preprocess["trim_ms"], 1000 * trace.block / trace.rate_hz
    lines.append(f"{takes}{len(trace) / trace.rate_hz:g} s in {trace.n_blocks} {cut_in_words(trim_ms, block_ms)}")
    if trained.texture.sizes.editable:
        lines += [f"random part: {random_part_summary(card)}", f"network: {network_summary(card)}"]
    lines.append(f"above the trained range, {trained.texture.extrapolation_in_words()}")
    if trace.n_uncovered:
        lines.append(f"not used: {_duration(trace.n_uncovered, trace.rate_hz)} that only some of the sensors recorded")
    if trace.n_dropped:
        lines.append(f"not used: {_duration(trace.n_dropped, trace.rate_hz)} at the end, too short for another block")
    where = f"{condition['speed']:.0f} mm/s and {condition['force']:.2f} N"
    return "\n".join([*lines, f"warm start (first window) {origin} at {where}, nearest the paper's 45 mm/s and 0.8 N"])


def _duration(n_samples: int, rate_hz: float) -> str:
    """Time that some samples last, in words."""
    seconds = n_samples / rate_hz
    return f"{seconds:.2f} s" if seconds >= 1 else f"{1000 * seconds:.0f} ms"


def unusable(inspection: Inspection, in_full: Sequence[str] = (), besides: tuple[str, ...] = ()) -> list[str]:
    """Why nothing sensible can be learned, but for findings with some codes; each as a longer sentence has it that begins so."""
    texts = [
        finding.text
        for finding in inspection.findings
        if finding.severity == "unusable" and finding.code not in besides
    ]
    return [next((sentence for sentence in in_full if sentence.startswith(text)), text) for text in texts]


def check_usable(refusals: Sequence[str]) -> None:
    """Refuse a recording from which nothing sensible can be learned, with all reasons."""
    if refusals:
        first, *others = refusals
        sentences = ". ".join([first, *(f"{text[0].upper()}{text[1:]}" for text in others)])
        raise ValueError(f"nothing sensible can be learned: {sentences} (use --anyway to continue)")


def _notes(inspection: Inspection, rate_hz: float) -> Iterator[str]:
    """Warnings of the inspection of a recording for its training."""
    from foten.dsp import perception

    shares = inspection.carried
    yield from (f"problem: {problem.text}" for problem in inspection.problems)
    if shares and rate_hz < perception.smallest_rate(shares):
        more = f"--rate {perception.smallest_rate(shares):g} would keep more"
        yield f"of the perceived power, a sampling rate of {perception.in_words(shares)}: {more}"


def _settings(pairs: list[str]) -> dict[str, Any]:
    """Mapping of SIZE=VALUE pairs; a value that is no JSON is a word."""
    sizes: dict[str, Any] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name or not value:
            raise ValueError(f"--set {pair}: expected SIZE=VALUE, such as --set n_layers=2")
        try:
            sizes[name.strip()] = json.loads(value)
        except json.JSONDecodeError:
            sizes[name.strip()] = value.strip()
    return sizes
