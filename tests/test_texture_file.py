import contextlib
import dataclasses
import json
import pickle
import struct
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import save

from conftest import exported
from foten.models.registry import MODELS
from foten.models.texture_file import Texture, read_texture, texture_from_bytes, write_texture
from foten.recording.recording import UNITS
from foten.runtime.native import NativeTexture


def raw(card: Any, tensors: dict[str, np.ndarray]) -> bytes:
    """A file with any card, valid or not."""
    text = card if isinstance(card, str) else json.dumps(card)
    return bytes(save({name: np.ascontiguousarray(t) for name, t in tensors.items()}, metadata={"foten": text}))


def with_tensor(texture: Texture, name: str, tensor: np.ndarray) -> bytes:
    return raw(dict(texture.card), {**texture.tensors, name: tensor})


def test_a_round_trip_keeps_everything(texture: Texture, tmp_path: Path) -> None:
    path = tmp_path / "mesh.foten"
    write_texture(texture, path)
    back = read_texture(path)
    assert back.card == texture.card
    assert set(back.tensors) == set(texture.tensors)
    for name, tensor in texture.tensors.items():
        assert back.tensors[name].dtype == tensor.dtype
        np.testing.assert_array_equal(back.tensors[name], tensor)
    assert back.sha256() == texture.sha256()
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.foten"]


def test_the_same_texture_is_the_same_bytes(texture: Texture) -> None:
    shuffled = Texture(card=dict(reversed(texture.card.items())), tensors=dict(reversed(texture.tensors.items())))
    assert shuffled.to_bytes() == texture.to_bytes() == texture_from_bytes(texture.to_bytes()).to_bytes()


def test_a_header_of_any_length_is_read(texture: Texture) -> None:
    """The first byte of the file is that of a length, and may be the first of a pickle too."""
    seen = set()
    for n in range(0, 256, 8):
        data = dataclasses.replace(texture, card={**texture.card, "notes": "x" * n}).to_bytes()
        seen.add(data[0])
        assert texture_from_bytes(data).card["notes"] == "x" * n
    assert seen == set(range(0, 256, 8))


NONE = "no growth could be learned from the recording"


@pytest.mark.parametrize(
    ("model", "speed", "force", "words"),
    [
        (
            "foten-plus",
            0.714,
            0.4,
            "the level follows speed^0.71 and force^0.4, up to twice the range or 400 mm/s and 6 N",
        ),
        (
            "foten-plus",
            0.0,
            1.5,
            f"the level follows force^1.5, up to twice the range or 400 mm/s and 6 N; with speed it is held: {NONE}",
        ),
        ("foten-plus", 0.0, 0.0, f"the level is held: {NONE}"),
        ("foten", 0.0, 0.0, "the level is held: foten learns no growth"),
    ],
)
def test_it_says_how_the_level_goes_on_above_its_range(model: str, speed: float, force: float, words: str) -> None:
    card = {"model": model, "sizes": {}, "extrapolation_exponents": {"force": force, "speed": speed}}
    assert Texture(card=card, tensors={}).extrapolation_in_words() == words


def test_every_truncation_is_refused(texture: Texture) -> None:
    data = texture.to_bytes()
    header = 8 + struct.unpack("<Q", data[:8])[0]
    rng = np.random.default_rng(0)
    lengths = {0, 1, 7, 8, 9, header - 1, header, header + 1, len(data) - 1}
    lengths |= {int(n) for n in rng.integers(0, header, 20)} | {int(n) for n in rng.integers(header, len(data), 20)}
    for length in lengths:
        with pytest.raises(ValueError, match="truncated"):
            texture_from_bytes(data[:length])


def test_a_relative_acceleration_is_understood(texture: Texture) -> None:
    card = {**texture.card, "units": {**UNITS, "acceleration": "relative"}}
    assert texture_from_bytes(raw(card, dict(texture.tensors))).unit == "relative"


def test_the_message_names_the_file(texture: Texture, tmp_path: Path) -> None:
    path = tmp_path / "half.foten"
    path.write_bytes(texture.to_bytes()[:1000])
    with pytest.raises(ValueError, match=r"^half\.foten: .*truncated"):
        read_texture(path)
    with pytest.raises(FileNotFoundError):
        read_texture(tmp_path / "none.foten")


def test_pickles_and_checkpoints_are_never_opened(tmp_path: Path) -> None:
    import torch

    zipped = BytesIO()
    with zipfile.ZipFile(zipped, "w") as archive:
        archive.writestr("a", "b")
    checkpoint = BytesIO()
    torch.save({"weight": torch.zeros(3)}, checkpoint)
    touched = tmp_path / "touched"

    class Malicious:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (touched,))

    for data in (pickle.dumps(Malicious()), zipped.getvalue(), checkpoint.getvalue()):
        with pytest.raises(ValueError, match=r"pickle or a PyTorch checkpoint.*never opened"):
            texture_from_bytes(data)
    assert not touched.exists()


@pytest.mark.parametrize(
    "data",
    [b"", b"RIFF....WAVEfmt ", b"\x89HDF\r\n\x1a\n" + bytes(100), b"a,b\n1,2\n" * 50, bytes(64), b"\xff" * 64],
    ids=["empty", "wav", "hdf5", "csv", "zeros", "ones"],
)
def test_other_files_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="texture file"):
        texture_from_bytes(data)


def test_foreign_safetensors_are_refused() -> None:
    for metadata in (None, {"format": "pt"}):
        with pytest.raises(ValueError, match="safetensors file without a texture card"):
            texture_from_bytes(bytes(save({"weight": np.zeros(3)}, metadata=metadata)))


def test_every_key_of_the_card_is_needed_and_has_its_type(texture: Texture) -> None:
    for key in set(texture.card) - {"format_version"}:
        without = {k: v for k, v in texture.card.items() if k != key}
        with pytest.raises(ValueError, match=f"the card has no '{key}'"):
            texture_from_bytes(raw(without, dict(texture.tensors)))
        with pytest.raises(ValueError, match=f"'{key}' in the card is True, expected"):
            texture_from_bytes(raw({**texture.card, key: True}, dict(texture.tensors)))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"format_version": 7}, "format version 7, expected 6: update foten"),
        ({"format_version": 5}, "format version 5, expected 6: train it again: foten train RECORDING"),
        ({"format_version": None}, "format version None"),
        ({"model": "wavenet"}, "unknown model 'wavenet', expected one of foten-plus, foten, ten, ar"),
        ({"window": 21}, "window 21 and the network 19"),
        ({"sizes": {"width": 3}}, "foten-plus has no size 'width', expected one of window, n_hidden"),
        ({"sizes": {"window": 1}}, "window is 1"),
        ({"rate_hz": 0}, "'rate_hz' in the card is 0"),
        ({"rate_hz": float("nan")}, "'rate_hz' in the card is nan"),
        ({"saturation": -1.0}, "'saturation' in the card is -1.0"),
        ({"lowpass_hz": float("inf")}, "'lowpass_hz' in the card is inf"),
        ({"lowpass_hz": 5e-324}, "from 0.001 Hz to half of that"),
        ({"lowpass_hz": 500.0}, "from 0.001 Hz to half of that"),
        ({"trained_range": {"speed": [8.0, 220.0]}}, "trained range of force is None"),
        ({"trained_range": {"speed": [220.0, 8.0], "force": [0, 1]}}, "trained range of speed"),
        ({"trained_range": {"speed": [-1.0, 8.0], "force": [0, 1]}}, "trained range of speed"),
        ({"trained_range": {"speed": [float("nan"), 8.0], "force": [0, 1]}}, "trained range of speed"),
        ({"units": {**UNITS, "speed": "m/s"}}, "^the card's speed is in 'm/s', expected mm/s; was the card edited[?]$"),
        ({"units": {**UNITS, "force": ["N"]}}, r"force is in \['N'\], expected N"),
        ({"units": {**UNITS, "acceleration": "g"}}, r"acceleration is in 'g', expected m/s\^2 or relative"),
        ({"units": {}}, "acceleration is in None, expected"),
        ({"training": {"unfinished": "no"}}, "'unfinished' in the card is 'no', expected true"),
        ({"microphone": None}, "'microphone' in the card is None, expected true"),
        ({"scaling": {"mean": [0, 0, 0]}}, "three means and three standard deviations"),
        ({"scaling": {"mean": [0, 0], "sd": [1, 1]}}, "three means"),
        ({"scaling": {"mean": ["a", 0, 0], "sd": [1, 1, 1]}}, "three means"),
        ({"trained_range": {"speed": [None, 1], "force": [0, 1]}}, "trained range of speed"),
        ({"rate_hz": 10**400}, "expected a positive number"),
        ({"scaling": {"mean": [0, 0, 0], "sd": [1, 0, 1]}}, "speed has mean 0 and standard deviation 0"),
    ],
)
def test_a_card_that_does_not_fit_is_refused(texture: Texture, fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        texture_from_bytes(raw({**texture.card, **fields}, dict(texture.tensors)))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["warm_start", "lattice.reflections", "golden.one_step", "network.head.weight"])
def test_a_tensor_with_nan_is_refused(texture: Texture, name: str, value: float) -> None:
    tensor = texture.tensors[name].copy()
    tensor.flat[-1] = value
    with pytest.raises(ValueError, match=f"tensor '{name}' holds NaN or infinity"):
        texture_from_bytes(with_tensor(texture, name, tensor))


@pytest.mark.parametrize("dtype", [np.int64, np.float16, np.bool_])
def test_only_floats_of_32_and_64_bits(texture: Texture, dtype: type) -> None:
    with pytest.raises(ValueError, match="expected float32 or float64"):
        texture_from_bytes(with_tensor(texture, "lattice.reflections", np.zeros((6, 6), dtype)))


@pytest.mark.parametrize(
    ("name", "shape"),
    [("warm_start", (18, 3)), ("warm_start", (60,)), ("golden.one_step", (34, 1)), ("golden.closed_loop", (65,))],
)
def test_a_tensor_of_another_shape_is_refused(texture: Texture, name: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=rf"tensor '{name}' has shape \({shape[0]}.*expected"):
        texture_from_bytes(with_tensor(texture, name, np.zeros(shape)))


def test_a_name_that_is_there_twice_is_refused(texture: Texture) -> None:
    """Readers differ in which of the two counts, and in whether an escape makes a name another one."""
    data, card = texture.to_bytes(), json.dumps(dict(texture.card))
    end = 8 + struct.unpack("<Q", data[:8])[0]
    header = b'{"warm_start":{},' + data[9:end]  # the last counts, until the kernel counts tensors
    twice = struct.pack("<Q", len(header)) + header + data[end:]
    with pytest.raises(ValueError, match="a name is in it twice"):
        texture_from_bytes(twice)
    with pytest.raises(ValueError, match="holds 37 tensors, expected the 36"):
        NativeTexture(twice)
    for name in ("rate_hz", r"rate_h\u007a"):
        with pytest.raises(ValueError, match=r"the card is not JSON \(a name is in it twice"):
            texture_from_bytes(raw(f'{card[:-1]}, "{name}": 500.0}}', dict(texture.tensors)))


def test_an_unknown_tensor_is_refused(plain_texture: Texture) -> None:
    tensors = {**plain_texture.tensors, "golden.sigma": plain_texture.tensors["golden.one_step"]}
    with pytest.raises(ValueError, match=r"a tensor 'golden[.]sigma' that"):
        texture_from_bytes(raw(dict(plain_texture.card), tensors))


@pytest.mark.parametrize("key", [*MODELS, "fnn", "gan"])
def test_every_tensor_is_needed(key: str) -> None:
    """By whoever reads the file, and by the kernel."""
    texture = exported(key)
    for name in texture.tensors:
        without = {other: tensor for other, tensor in texture.tensors.items() if other != name}
        data = dataclasses.replace(texture, tensors=without).to_bytes()
        with pytest.raises(ValueError, match=r"has shape None|has shape \(0,\)|0 golden windows|or a graph"):
            texture_from_bytes(data)
        with pytest.raises(ValueError, match=r"tensor|golden|graph"):
            NativeTexture(data)


@pytest.mark.parametrize(
    "name",
    ["head_1.weight", "temporal.layers.1.attention_in.weight", "spectral.phase_in.weight", "temporal.norm.weight"],
)
def test_a_tensor_of_another_size_is_refused(plain_texture: Texture, name: str) -> None:
    tensors = {**plain_texture.tensors, name: plain_texture.tensors[name][:-2]}
    data = dataclasses.replace(plain_texture, tensors=tensors).to_bytes()
    with pytest.raises(ValueError, match=f"tensor '{name}' has shape"):
        texture_from_bytes(data)
    with pytest.raises(ValueError, match=name):
        NativeTexture(data)


@given(position=st.floats(0, 1), value=st.integers(0, 255))
@settings(max_examples=60, deadline=None)
def test_a_damaged_header_is_a_value_error_or_none(texture: Texture, position: float, value: int) -> None:
    data = bytearray(texture.to_bytes())
    header = 8 + struct.unpack("<Q", data[:8])[0]
    data[int(position * (header - 1))] = value
    with contextlib.suppress(ValueError):
        texture_from_bytes(bytes(data))


def test_a_failing_write_keeps_what_was_there(
    texture: Texture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.foten"
    write_texture(texture, path)
    before = path.read_bytes()
    incomplete = dataclasses.replace(texture, card={k: v for k, v in texture.card.items() if k != "licence"})
    with pytest.raises(ValueError, match="no 'licence'"):
        write_texture(incomplete, path)

    def full_disk(self: Path, data: bytes) -> int:
        with open(self, "wb") as file:
            file.write(data[:100])
        raise OSError("no space left")

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(OSError, match="no space"):
        write_texture(texture, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.foten"]


DEEP = "[" * 100_000
DEEP_CARDS = [DEEP, DEEP + "]" * 100_000, '{"a":' * 200 + "1" + "}" * 200]


@pytest.mark.parametrize("card", [*DEEP_CARDS, "9" * 5000, "[null]", "{not json", "3"])
def test_json_that_cannot_be_read_is_a_value_error(texture: Texture, card: str) -> None:
    with pytest.raises(ValueError, match="the card is not"):
        texture_from_bytes(raw(card, dict(texture.tensors)))
    data = struct.pack("<Q", len(card)) + card.encode()
    with pytest.raises(ValueError, match="this is not a texture file"):
        texture_from_bytes(data)


@pytest.mark.parametrize("value", [[None], 2**70, 10**400, -(10**400), 1e300, None, {"a": [None]}, "\ud800", [DEEP]])
def test_no_value_anywhere_in_a_card_is_more_than_a_value_error(texture: Texture, value: Any) -> None:
    """Each key of the card and of what it holds, in turn: refused, or such that the file can be written and proved again."""
    for key, inside in texture.card.items():
        cards = [{**texture.card, key: value}]
        if isinstance(inside, dict):
            cards += [{**texture.card, key: {**inside, name: value}} for name in inside]
        for card in cards:
            with contextlib.suppress(ValueError):
                texture_from_bytes(raw(card, dict(texture.tensors))).sha256()


def test_numbers_that_only_overflow_are_refused(texture: Texture) -> None:
    tensor = texture.tensors["warm_start"].copy()
    tensor.flat[0] = 3e38
    with pytest.raises(ValueError, match=r"'warm_start' holds 3e\+38, expected 1e\+09 at most"):
        texture_from_bytes(with_tensor(texture, "warm_start", tensor))
