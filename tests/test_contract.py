"""Promises of every model: a file trained on a tiny trace loads without PyTorch, is judged, and renders."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from torch import Tensor, nn

from conftest import config_of, sizes_with
from foten.cli.command_line import _status
from foten.datasets.hdf5 import write_recording
from foten.evaluate.evaluate import evaluate
from foten.evaluate.report.rows import to_text
from foten.models.definitions import render
from foten.models.graph import graph_of
from foten.models.texture_file import CLOSED_LOOP_TOLERANCE, Texture, write_texture
from foten.models.trainable import TRAINABLE, train
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.runtime.bench import INSTRUCTION_SETS, time_all
from foten.runtime.native import NativeTexture
from foten.runtime.onnx_predictor import OnnxPredictor, model_of_graph
from foten.runtime.renderer import Renderer
from foten.simulation.simulate import simulate
from foten.training import calibration
from foten.training.job import TrainingJob
from foten_lab.baselines.sizes import BASELINES

FROM_NOISE = [key for key, model in BASELINES.items() if not model.sizes.predicts_samples]

SMALL = {
    **{"d_model": 8, "n_heads": 2, "n_layers": 1, "d_feedforward": 16, "head": (16, 8), "spectral_width": 8},
    **{"channels": 8, "squeezed": 2, "recurrent": 8, "dense": 8, "first": 8, "second": 4, "n_lags": 3},
    **{"n_hidden": 6, "head_width": 5, "n_components": 2, "window": 40, "excitation": True},
}
SHORT = PreprocessConfig(trim_ms=0, block_ms=400)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate("linear-twin", 2.5)


@pytest.fixture(scope="module")
def textures(recording: Recording) -> dict[str, Texture]:
    """Every model, trained for a moment; few closed loops settle its level, which take graphs seconds."""
    trained = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "N_CALIBRATION_RUNS", (1,))
        patch.setattr(calibration, "N_RUNS", 2)
        for key in TRAINABLE:
            short = {"epochs": 1, "batch": 64, "threads": 1, "max_order": 8, "tones": False}
            short |= {"gan": {"batch": 8}, "ldhtd": {"epochs": 2}}.get(key, {})
            sizes = {"window": 42, "frame": 16, "stride": 1} if key == "gan" else SMALL
            config = config_of(key, **short)
            trained[key] = train(TrainingJob(recording, key, sizes_with(key, sizes), config, SHORT)).texture
    return trained


def test_each_loads_without_pytorch_is_judged_and_renders(
    textures: dict[str, Texture], recording: Recording, tmp_path: Path
) -> None:
    write_recording(recording, tmp_path / "recording.h5")
    for key, texture in textures.items():
        write_texture(texture, tmp_path / f"{key}.foten")
    program = """
import json, sys
from pathlib import Path

class NoTorch:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "torch":
            raise ImportError("blocked", name="torch")

sys.meta_path.insert(0, NoTorch())
import numpy as np
from foten.datasets.hdf5 import load_recording
from foten.evaluate.evaluate import evaluate
from foten.runtime.renderer import Renderer
from foten.models.texture_file import read_texture
folder, judged = Path(sys.argv[1]), {}
recording = load_recording(folder / "recording.h5")
for path in sorted(folder.glob("*.foten")):
    document = evaluate(read_texture(path), recording).document
    out = Renderer(path, rate=8000, seed=1).render(speed_mm_s=80.0, force_n=0.8, n=8000)
    judged[path.stem] = {
        "one_step": document["one_step"]["mae_scaled"], "nll": document["one_step"].get("nll"),
        "free_run": document["free_run"]["lsd_db"], "zero": document["references"]["zero"]["mae_scaled"],
        "finite": bool(np.isfinite(out).all()), "peak": float(np.abs(out).max()), "sd": float(out.std()),
    }
print(json.dumps(judged))
"""
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    judged = json.loads(done.stdout)
    assert set(judged) == set(TRAINABLE)
    for key, of in judged.items():
        texture = textures[key]
        bound = texture.card["saturation"] * texture.scaling.sd[0]
        assert of["finite"], key
        assert 0.02 * texture.scaling.sd[0] < of["sd"], key
        # The change of rate lets a cut wave overshoot a little.
        assert of["peak"] < 1.3 * bound, key
        assert np.isfinite(of["free_run"]), key
        if key in FROM_NOISE:  # it predicts no sample
            assert of["one_step"] is None, key
            assert of["nll"] is None, key
        else:
            assert of["one_step"] < 1.2 * of["zero"], key
            assert np.isfinite(of["nll"]), key


@pytest.mark.parametrize("key", TRAINABLE)
def test_the_kernel_renders_what_the_reference_renders(textures: dict[str, Texture], key: str) -> None:
    """Seam: ONNX Runtime called from the kernel's loop, beside it in the reference's.

    The kernel takes speeds in float32, and what is begun with is the loop's own output: twice a proof's tolerance.
    """
    texture = textures[key]
    speed, force = np.linspace(20, 160, 64), np.linspace(0.4, 1.5, 64)
    expected = render(texture, speed, force, seed=5, model=model_of_graph(texture) if key in BASELINES else None)[0]
    rendered = Renderer(texture, seed=5).render(speed, force)
    scale = texture.scaling.sd[0] * np.maximum(1.0, np.abs(expected / texture.scaling.sd[0]))
    assert (np.abs(rendered - expected) / scale).max() < 2 * CLOSED_LOOP_TOLERANCE
    assert np.abs(expected).max() > 0


@pytest.mark.parametrize("key", TRAINABLE)
def test_blocks_of_any_size_give_the_same_bytes(textures: dict[str, Texture], key: str) -> None:
    at_once, pieces = (Renderer(textures[key], rate=3000, seed=2) for _ in range(2))
    expected = at_once.render(speed_mm_s=70.0, force_n=1.0, n=300)
    blocks = [pieces.render(speed_mm_s=70.0, force_n=1.0, n=n) for n in (1, 7, 100, 192)]
    np.testing.assert_array_equal(np.concatenate(blocks), expected)
    at_once.reset()
    np.testing.assert_array_equal(at_once.render(speed_mm_s=70.0, force_n=1.0, n=300), expected)


@pytest.mark.parametrize("key", BASELINES)
def test_a_damaged_graph_is_refused_in_one_line(textures: dict[str, Texture], key: str) -> None:
    texture = textures[key]
    for graph in (texture.tensors["graph"][:-200], np.zeros(10, dtype=np.uint8)):
        data = Texture(texture.card, {**texture.tensors, "graph": graph}).to_bytes()
        with pytest.raises(ValueError, match="the texture's graph is damaged") as error:
            NativeTexture(data)
        assert "\n" not in str(error.value)


class Several(nn.Module):
    """A network of the last three samples."""

    def forward(self, windows: Tensor) -> Tensor:
        return windows[:, -3:, 0]


SQUARE = """<ir_version: 8, opset_import: ["" : 17]> square (float[b, %d, 3] windows) => (float[b] next) {
    axes = Constant<value_ints = [1, 2]>() total = ReduceSum<keepdims = 0>(windows, axes)
    shape = Constant<value_ints = [%d, %d]>() zeros = ConstantOfShape(shape) sum = ReduceSum<keepdims = 0>(windows)
    filled = Add(zeros, sum) product = MatMul(filled, filled) one = ReduceSum<keepdims = 0>(product) next = Add(total, one)
}"""


def test_a_graph_that_is_none_of_ours_is_not_run(textures: dict[str, Texture]) -> None:
    """One gives several samples, one has other weights; one loops 2⁶² times, which whoever opens the file would run."""
    texture = textures["fnn"]
    model = onnx.load_from_string(texture.tensors["graph"].tobytes())
    model.graph.node.append(onnx.helper.make_node("Loop", ["", ""], ["never"]))
    looping = np.frombuffer(model.SerializeToString(), dtype=np.uint8)
    squares = [onnx.parser.parse_model(SQUARE % (texture.window, n, n)).SerializeToString() for n in (9000, 2500)]
    for changes, refusal in (
        ({"graph": graph_of(Several(), texture.window)}, r"the graph gives \(2, 3\) of two windows, expected \(2,\)"),
        ({"golden.one_step": texture.tensors["golden.one_step"] + 1e-3}, "fails its own proof: one step"),
        ({"graph": looping}, "foreign operator Loop, and is not run"),
        ({"graph": np.frombuffer(squares[0], dtype=np.uint8)}, "graph does not run within its bounds: .*bfc_arena"),
        ({"graph": np.frombuffer(squares[1], dtype=np.uint8)}, "graph takes .* s for two windows, expected 0.1"),
    ):
        with pytest.raises(ValueError, match=refusal):
            NativeTexture(Texture(texture.card, {**texture.tensors, **changes}).to_bytes())


@pytest.mark.parametrize("key", ["dstn", "ldhtd"])
def test_what_goes_wrong_while_the_kernel_asks_is_raised(
    textures: dict[str, Texture], monkeypatch: pytest.MonkeyPatch, key: str
) -> None:
    """Python delivers Ctrl-C inside the callback, where it would be printed and lost."""
    renderer = Renderer(textures[key], excitation=False)
    n_calls = 0

    def interrupted(predictor: object, window: object) -> float:
        nonlocal n_calls
        n_calls += 1
        raise KeyboardInterrupt

    monkeypatch.setattr(OnnxPredictor, "next_sample", interrupted)
    with pytest.raises(KeyboardInterrupt):
        renderer.render(speed_mm_s=80.0, force_n=1.0, n=10_000)
    assert n_calls == 1
    monkeypatch.undo()
    # One sample was silence, and those after it are asked for again.
    mean = np.float32(textures[key].scaling.mean[0])
    assert (renderer.render(speed_mm_s=80.0, force_n=1.0, n=10) != mean).all()
    renderer.reset()
    assert np.isfinite(renderer.render(speed_mm_s=80.0, force_n=1.0, n=10)).all()


@pytest.mark.parametrize("key", TRAINABLE)
def test_info_says_what_is_in_a_file(
    textures: dict[str, Texture], key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_texture(textures[key], tmp_path / "t.foten")
    assert _status(["info", str(tmp_path / "t.foten")]) == 0
    out = capsys.readouterr().out
    assert all(word in out for word in (key, "multiply-adds", "mm/s", "m/s²", textures[key].extrapolation_in_words()))


@pytest.mark.parametrize("key", ["ar", "fnn"])
def test_an_evaluation_keeps_the_model_apart_from_the_references(
    textures: dict[str, Texture], recording: Recording, key: str
) -> None:
    """There is a reference "ar" beside a model "ar": each has a line with its own error."""
    document = evaluate(textures[key], recording).document
    lines = to_text(document).split("\n\n")[1].splitlines()  # of one step
    for name, row in ((f"{key} ", document["one_step"]), ("AR(20) ", document["references"]["ar"])):
        line = next(line for line in lines if line.startswith(name))
        assert f"{row['mae_scaled']:.4f}"[:5] in line
    assert document["one_step"]["mae_scaled"] != document["references"]["ar"]["mae_scaled"]


def test_a_graph_is_timed_once_and_called_by_what_runs_it(textures: dict[str, Texture], tmp_path: Path) -> None:
    """The kernel's instruction sets say nothing of a model that ONNX Runtime runs."""
    for key, names in (("fnn", {"onnxruntime"}), ("ten", {*INSTRUCTION_SETS})):
        write_texture(textures[key], tmp_path / f"{key}.foten")
        times = time_all(tmp_path / f"{key}.foten", 50)
        assert {one.isa for one in times} <= names
        assert times


def test_without_onnx_runtime_one_line_says_so(textures: dict[str, Texture], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ValueError, match=r"pip install './packages/foten\[onnx\]'"):
        Renderer(textures["dstn"])
    assert Renderer(textures["foten"]).render(speed_mm_s=80.0, force_n=1.0, n=10).size == 10


@pytest.mark.parametrize("key", FROM_NOISE)
def test_a_model_of_noise_is_silent_without_chance(textures: dict[str, Texture], key: str) -> None:
    texture = textures[key]
    speed, force = np.linspace(20, 160, 64), np.linspace(0.8, 1.5, 64)  # in the trained range, below which it fades
    silent = Renderer(texture, excitation=False).render(speed, force)
    np.testing.assert_allclose(silent, texture.scaling.mean[0], atol=1e-6)
    assert np.abs(Renderer(texture).render(speed, force) - texture.scaling.mean[0]).max() > 0.1
