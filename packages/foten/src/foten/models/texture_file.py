"""The texture file: a safetensors file of tensors, a card, and golden samples (docs/texture-file.md).

A runtime that does not reproduce these within `ONE_STEP_TOLERANCE` and `CLOSED_LOOP_TOLERANCE` refuses the file.
"""

import hashlib
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import atomic_write
from foten.models.conditions import FADE_FORCE, FADE_SPEED, REACH_FORCE, REACH_SPEED
from foten.models.model_sizes import ModelSizes, shortened
from foten.models.registry import GRAPH, MODELS, sizes_of
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import RELATIVE, UNITS, range_in_words
from foten.recording.scaling import Scaling
from foten.recording.split import Split
from foten.recording.trace import CHANNELS
from foten.untrusted import check_numbers, parse_json, printable, read_whole

FORMAT_VERSION = 6
ONE_STEP_TOLERANCE = 1e-5  # scaled; float32 arithmetic of the network
CLOSED_LOOP_TOLERANCE = 1e-4  # scaled, of each of 64 steps
MIN_GOLDEN = 8  # windows
MAX_RATE_HZ = 1e5
MAX_NUMBER = 1e9  # of a number in a tensor; squares of it are finite in float32
CODED = ("recorded.innovations", "recorded.moments")  # tensors of bytes
MAX_CREDIT = 500  # characters
_MAX_HEADER = 10_000_000  # bytes; a card has 20,000, and reading takes a minute for the most that safetensors allows

_CARD: Mapping[type | tuple[type, ...], str] = {
    int: "format_version window",
    (int, float): "rate_hz saturation lowpass_hz delay_ms",
    str: "model texture tool sensors notes licence recording_sha256 split_sha256",
    dict: "sizes units scaling trained_range extrapolation_exponents warm_start preprocess training metrics",
    (dict, type(None)): "split",
}
"""Keys of a card by JSON type; a texture that was not trained here has no split."""
CREDIT = ("authors", "source", "doi", "photo")
"""Keys of a card that say whose it is, each of which may be absent: of the recording, where it is from, and of the photograph."""
EVIDENCE = "evidence"
"""Key of a card that says from what a texture was made, where not from a recording; it may be absent."""
_VALIDATED = ("validation_mae_scaled", "validation_spectrum_db")  # of which a trained model has one


@dataclass(frozen=True)
class Texture:
    """A texture file in memory."""

    card: Mapping[str, Any]  # as `_CARD` lists it; units m/s², mm/s, N
    tensors: Mapping[str, NDArray[Any]]  # float32 or float64
    file: str = ""  # that it was read from, for messages

    @property
    def rate_hz(self) -> float:
        """The model's rate [Hz]."""
        return float(self.card["rate_hz"])

    @property
    def window(self) -> int:
        """m, how many samples a prediction is given."""
        return int(self.card["window"])

    @property
    def sizes(self) -> ModelSizes:
        """The model's sizes."""
        return sizes_of(self.card["model"], self.card["sizes"])

    @property
    def scaling(self) -> Scaling:
        """The scaling of acceleration, speed and force."""
        fields = self.card["scaling"]
        return Scaling(mean=tuple(fields["mean"]), sd=tuple(fields["sd"]))

    @property
    def unit(self) -> str:
        """The unit of the acceleration as people read it: m/s², or relative to the recording's RMS."""
        return self.card["units"]["acceleration"].replace("^2", "²")

    @property
    def credit(self) -> str:
        """Whom to name where it is passed on, in a line: authors, source, doi, licence; empty where the card says nothing."""
        card = self.card
        doi, photo = (
            f"{mark} {card[key]}" if card.get(key) else "" for key, mark in (("doi", "doi"), ("photo", "photo:"))
        )
        parts = (card.get("authors"), card.get("source"), doi, photo, card["licence"])
        return ", ".join(part for part in parts if part)

    @property
    def evidence(self) -> str:
        """From what it was made; empty for a recording."""
        return str(self.card.get(EVIDENCE, ""))

    @property
    def unfinished(self) -> str:
        """Sentence on a texture that was written before its training ended; empty for others."""
        if not self.card["training"].get("unfinished", False):
            return ""
        return "its training has not ended: this is an early texture"

    @property
    def has_excitation(self) -> bool:
        """Whether there is a random part."""
        return self.sizes.excited or not self.predicts_samples

    @property
    def predicts_samples(self) -> bool:
        """Whether the model predicts samples; one of spectra makes them from noise, and predicts none."""
        return self.card["split"] is None or self.card["metrics"].get("validation_mae_scaled") is not None

    def trained_range(self, channel: str) -> tuple[float, float]:
        """Lowest and highest trained `speed` [mm/s] or `force` [N]."""
        low, high = self.card["trained_range"][channel]
        return float(low), float(high)

    def trained_range_in_words(self) -> str:
        """Trained range of speed and force: "0 to 330 mm/s and 0.18 to 3.2 N"."""
        return " and ".join(range_in_words(channel, *self.trained_range(channel)) for channel in ("speed", "force"))

    def extrapolation_exponent(self, channel: str) -> float:
        """The power of `speed` or `force` that the level grows with above its trained range."""
        return float(self.card["extrapolation_exponents"][channel])

    def fades_below(self, channel: str) -> float:
        """Speed [mm/s] or force [N] below which a rendering fades: near rest, or below the trained range if the level is held."""
        rest = {"speed": FADE_SPEED, "force": FADE_FORCE}[channel]
        return rest if self.extrapolation_exponent(channel) > 0 else max(rest, self.trained_range(channel)[0])

    def fading_in_words(self) -> str:
        """Where a rendering fades: "below 2 mm/s or 0.1 N"."""
        return f"below {self.fades_below('speed'):.4g} mm/s or {self.fades_below('force'):.3g} N"

    def extrapolation_in_words(self) -> str:
        """Sentence on the level outside the trained range: where it follows a law, and where and why it is held above."""
        powers, model = {name: self.extrapolation_exponent(name) for name in ("speed", "force")}, self.card["model"]
        grows = " and ".join(f"{name}^{power:.2g}" for name, power in powers.items() if power)
        held = " and ".join(name for name, power in powers.items() if not power)
        why = (
            "no growth could be learned from the recording" if self.sizes.learns_growth else f"{model} learns no growth"
        )
        if not grows:
            return f"the level is held: {why}"
        text = f"the level follows {grows}, up to twice the range or {REACH_SPEED:g} mm/s and {REACH_FORCE:g} N"
        return f"{text}; with {held} it is held: {why}" if held else text

    def to_bytes(self) -> bytes:
        """The file's bytes; the same texture gives the same bytes."""
        from safetensors.numpy import save

        check_card(self.card)
        tensors = {name: np.ascontiguousarray(self.tensors[name]) for name in sorted(self.tensors)}
        card = json.dumps(self.card, sort_keys=True, allow_nan=False)
        return bytes(save(tensors, metadata={"foten": card}))

    def sha256(self) -> str:
        return hashlib.sha256(self.to_bytes()).hexdigest()


def write_texture(texture: Texture, path: Path) -> None:
    """Write a texture file, whole or not at all."""
    with atomic_write(path) as part:
        part.write_bytes(texture.to_bytes())


def read_texture(path: Path | str) -> Texture:
    """The texture in a file.

    Raises:
        OSError: there is none, or it cannot be read.
        ValueError: it is not a texture file, is truncated, or its card or tensors do not fit.
    """
    path = Path(path)
    data = read_whole(path)
    try:
        return replace(texture_from_bytes(data), file=path.name)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def texture_from_bytes(data: bytes) -> Texture:
    """The texture in a file's bytes; errors as `read_texture`."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    if data[:8] == b"\x89HDF\r\n\x1a\n":
        raise ValueError("this is HDF5, as recordings are, expected a texture file; are two arguments swapped?")
    if len(data) < 9:
        raise ValueError(f"the file has {len(data)} bytes, expected a texture file; is it truncated?")
    # A header's length may begin as a pickle does; the brace after it tells them apart.
    if data[8:9] != b"{" and (data[:1] == b"\x80" or data[:4] == b"PK\x03\x04"):
        advice = "pickles can run code and are never opened: export with 'foten train'"
        raise ValueError(f"this is a pickle or a PyTorch checkpoint, expected a texture file; {advice}")
    (length,) = struct.unpack("<Q", data[:8])
    if not 0 < length <= min(_MAX_HEADER, len(data) - 8):
        raise ValueError("this is not a texture file, or it is truncated")
    try:
        metadata = parse_json(data[8 : 8 + length]).get("__metadata__") or {}
        tensors = load(data)
    except (SafetensorError, ValueError, AttributeError, KeyError, TypeError, OverflowError) as error:
        raise ValueError(f"this is not a texture file, or it is truncated ({error})") from error
    if not isinstance(metadata, dict) or "foten" not in metadata:
        raise ValueError("this is a safetensors file without a texture card, expected one written by 'foten train'")
    try:
        card = parse_json(metadata["foten"])
    except (ValueError, TypeError) as error:
        raise ValueError(f"the card is not JSON ({error})") from error
    check_card(card)
    check_numbers(card, "the card")
    for key in card.keys() - {"sensors", "notes"}:  # which alone may have several lines
        card[key] = printable(card[key]) if isinstance(card[key], str) else card[key]
    texture = Texture(card=card, tensors=tensors)
    _check_tensors(texture)
    return texture


def check_card(card: Any) -> None:
    """Refuse a card that is incomplete or inconsistent."""
    if not isinstance(card, Mapping):
        raise ValueError("the card is not a JSON object")
    version = card.get("format_version")
    if version != FORMAT_VERSION:
        older = type(version) is int and version < FORMAT_VERSION
        advice = "train it again: foten train RECORDING -o NAME.foten" if older else "update foten"
        raise ValueError(f"the file has format version {shortened(version)}, expected {FORMAT_VERSION}: {advice}")
    for kind, keys in _CARD.items():
        expected = "a number" if kind == (int, float) else getattr(kind, "__name__", "dict or null")
        for key in keys.split():
            if key not in card:
                raise ValueError(f"the card has no {key!r}")
            if not isinstance(card[key], kind) or isinstance(card[key], bool):
                raise ValueError(f"{key!r} in the card is {card[key]!r}, expected {expected}")
    try:
        sizes = sizes_of(card["model"], card["sizes"])
    except (TypeError, OverflowError) as error:  # a list where a number belongs
        raise ValueError(f"the sizes in the card do not fit together ({error})") from error
    if sizes.history != card["window"]:
        raise ValueError(f"the card has window {shortened(card['window'])} and the network {sizes.history}")
    _check_numbers(card)
    _check_units(card["units"])
    try:
        preprocess = PreprocessConfig.of_card(card["preprocess"])
        if card["split"] is not None:
            Split.from_fields(card["split"])
    except (TypeError, KeyError, AttributeError, OverflowError) as error:
        raise ValueError(f"the preprocessing or the split in the card is incomplete ({error})") from error
    if preprocess.rate_hz != card["rate_hz"]:
        raise ValueError(f"the card has a rate of {card['rate_hz']} Hz and preprocessing to {preprocess.rate_hz} Hz")
    _check_optional(card)
    metrics = card["metrics"]
    if card["split"] is not None and not any(_are_numbers([metrics.get(name)], 1) for name in _VALIDATED):
        raise ValueError(f"the card has none of {', '.join(_VALIDATED)} among its metrics")
    for name in ("validation_mae_scaled", "validation_mae_scaled_lattice"):
        if metrics.get(name) is not None and not _are_numbers([metrics[name]], 1):
            raise ValueError(f"{name!r} among the card's metrics is no number")


def _check_numbers(card: Mapping[str, Any]) -> None:
    for key in ("rate_hz", "saturation", "lowpass_hz"):
        if not (_are_numbers([card[key]], 1) and card[key] > 0):
            raise ValueError(f"{key!r} in the card is {card[key]}, expected a positive number")
    if not (card["rate_hz"] <= MAX_RATE_HZ and 1e-3 <= card["lowpass_hz"] < card["rate_hz"] / 2):
        raise ValueError(
            f"the card has a rate of {card['rate_hz']} Hz and a low-pass of {card['lowpass_hz']} Hz, expected up to "
            f"{MAX_RATE_HZ:g} Hz, and from 0.001 Hz to half of that"
        )
    for channel in ("speed", "force"):
        bounds, exponent = card["trained_range"].get(channel), card["extrapolation_exponents"].get(channel)
        if not (_are_numbers(bounds, 2) and 0 <= bounds[0] <= bounds[1]):
            raise ValueError(f"the trained range of {channel} is {bounds!r}, expected [low, high]")
        if not (_are_numbers([exponent], 1) and 0 <= exponent <= 2):
            raise ValueError(f"the exponent of {channel} beyond its range is {exponent!r}, expected 0 to 2")
    if not all(_are_numbers(card["scaling"].get(key), 3) for key in ("mean", "sd")):
        raise ValueError("the scaling in the card is not three means and three standard deviations")
    Scaling(mean=tuple(card["scaling"]["mean"]), sd=tuple(card["scaling"]["sd"]))


def _check_optional(card: Mapping[str, Any]) -> None:
    for key in (*CREDIT, EVIDENCE):
        if not isinstance(card.get(key, ""), str) or len(card.get(key, "")) > MAX_CREDIT:
            raise ValueError(f"{key!r} in the card is {shortened(card[key])}, expected {MAX_CREDIT} characters at most")
    for key, entries in (("unfinished", card["training"]), ("microphone", card)):
        if not isinstance(entries.get(key, False), bool):
            raise ValueError(f"{key!r} in the card is {shortened(entries[key])}, expected true")
    takes = card.get("takes", [])
    if not isinstance(takes, list) or not all(_is_take(take) for take in takes):
        raise ValueError(f"the takes in the card are {shortened(takes)}, expected a name, seconds and blocks of each")


def _check_units(units: Mapping[str, Any]) -> None:
    for channel in CHANNELS:
        known = (UNITS[channel], RELATIVE) if channel == "acceleration" else (UNITS[channel],)
        if units.get(channel) not in known:
            expected = f"expected {' or '.join(known)}; was the card edited?"
            raise ValueError(f"the card's {channel} is in {shortened(units.get(channel))}, {expected}")


def _is_take(take: Any) -> bool:
    numbers = isinstance(take, dict) and _are_numbers([take.get("seconds"), take.get("blocks")], 2)
    return numbers and isinstance(take.get("name"), str)


def _are_numbers(values: Any, n: int) -> bool:
    """Whether a JSON value is a list of n numbers that a float64 or an int64 holds."""
    of_length = isinstance(values, list) and len(values) == n
    return of_length and all(type(v) in (int, float) and abs(v) < 2**63 for v in values)  # NaN compares false


def _check_tensors(texture: Texture) -> None:
    sizes = texture.sizes
    for name, tensor in texture.tensors.items():
        if tensor.dtype == np.uint8 and name in (GRAPH, *CODED):
            continue
        if tensor.dtype not in (np.float32, np.float64):
            raise ValueError(f"tensor {name!r} is {tensor.dtype}, expected float32 or float64")
        if not np.isfinite(tensor).all():
            raise ValueError(f"tensor {name!r} holds NaN or infinity")
        if tensor.size and np.abs(tensor).max() > MAX_NUMBER:
            raise ValueError(f"tensor {name!r} holds {np.abs(tensor).max():g}, expected {MAX_NUMBER:g} at most")
    m, n_golden = texture.window, len(texture.tensors.get("golden.one_step", ()))
    if n_golden < MIN_GOLDEN:
        raise ValueError(f"the file holds {n_golden} golden windows, expected {MIN_GOLDEN} or more: it proves nothing")
    shapes = {
        **sizes.tensor_shapes(),
        "warm_start": (m, 3),
        "golden.windows": (n_golden, m, 3),
        "golden.one_step": (n_golden,),
        "golden.condition": (64, 2),
        "golden.closed_loop": (64,),
        **({"golden.sigma": (n_golden,)} if sizes.excited else {}),
    }
    if GRAPH in shapes and GRAPH not in texture.tensors:
        raise ValueError(f"unknown model {shortened(texture.card['model'])}, expected {', '.join(MODELS)}, or a graph")
    for name, shape in shapes.items():
        actual = texture.tensors[name].shape if name in texture.tensors else None
        known = actual or ()
        if len(known) != len(shape) or any(n not in (None, k) for n, k in zip(shape, known, strict=True)):
            raise ValueError(f"tensor {name!r} has shape {actual}, expected {shape}")
    unknown = set(texture.tensors) - set(shapes)
    if unknown:
        raise ValueError(f"the file holds a tensor {min(unknown)!r} that {texture.card['model']!r} does not have")
