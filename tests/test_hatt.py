"""Model files of the Penn Haptic Texture Toolkit: a file of our own making plays what its difference equations play."""

from __future__ import annotations

import json
import xml.etree.ElementTree as Xml
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter, welch

from foten.cli.command_line import _status
from foten.datasets.hatt import read_models
from foten.evaluate.evaluate import evaluate
from foten.models.piecewise_ar.local_models import imported_texture
from foten.models.texture_file import read_texture
from foten.runtime.renderer import Renderer
from foten.simulation.simulate import simulate

CORNERS = [(0.0, 0.0), (200.0, 0.0), (0.0, 4.0), (200.0, 4.0), (90.0, 1.0)]
TRIANGLES = [(1, 2, 5), (2, 4, 5), (4, 3, 5), (3, 1, 5)]


def resonance(frequency_hz: float, radius: float, rate_hz: float) -> np.ndarray:
    """1, a₁, a₂ with poles at a frequency."""
    return np.array([1.0, -2 * radius * np.cos(2 * np.pi * frequency_hz / rate_hz), radius * radius])


def written(path: Path, rate_hz: float = 1000.0, zeros: bool = True) -> Path:
    """Write five models of order 4, the loud ones at 90 mm/s and 1 N and in the far corner, lists in the toolkit's two ways."""
    root = Xml.Element("modelSet", texture="0")

    def add(parent: Xml.Element, name: str, value: object) -> None:
        Xml.SubElement(parent, name).text = str(value)

    def add_list(parent: Xml.Element, name: str, values: list[float], in_values: bool) -> None:
        element = Xml.SubElement(parent, name, type="array")
        if in_values:
            for value in values:
                Xml.SubElement(element, "value").text = repr(value)
        else:
            element.text = ",".join(repr(value) for value in values)

    texts = {"material": "Our Own Cloth", "AccelUnits": "m/s^2", "SpeedUnits": "mm/s", "ForceUnits": "N"}
    for name, value in {**texts, "SampleRate": rate_hz, "mu": 0.3, "numMod": len(CORNERS)}.items():
        add(root, name, value)
    for corners in TRIANGLES:
        add_list(root, "tri", list(corners), in_values=True)
    for i, (speed, force) in enumerate(CORNERS):
        model = Xml.SubElement(root, "model")
        a = np.convolve(resonance(0.12 * rate_hz, 0.9, rate_hz), resonance(0.3 * rate_hz, 0.8 + 0.02 * i, rate_hz))
        add_list(model, "ARcoeff", a.tolist(), in_values=i % 2 == 0)
        if zeros:
            add_list(model, "MAcoeff", resonance(0.2 * rate_hz, 0.7, rate_hz).tolist(), in_values=i % 2 == 1)
            add(model, "gain", 0.5)
        add(model, "var", 0.0 if 0 in (speed, force) else 2.0 + i)
        add(model, "speedMod", speed)
        add(model, "forceMod", force)
    Xml.ElementTree(root).write(path)
    return path


@pytest.mark.parametrize("zeros", [True, False])
@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0])
def test_it_plays_what_its_equation_plays(tmp_path: Path, rate_hz: float, zeros: bool) -> None:
    """Oracle: SciPy's direct form of the model at 90 mm/s and 1 N. Two seconds a segment keep the estimate within 1 dB."""
    models = read_models(written(tmp_path / "m.xml", rate_hz, zeros))
    texture, decisions = imported_texture(models, "0" * 64)
    assert decisions == []
    n = int(60 * rate_hz)
    played = Renderer(texture, rate=rate_hz, seed=1).render(speed_mm_s=90.0, force_n=1.0, n=n)
    e = np.sqrt(models.variance[4]) * np.random.default_rng(0).standard_normal(n)
    expected = lfilter(models.gain[4] * models.ma[4], models.ar[4], e)
    f, p = welch(played, rate_hz, nperseg=256)
    _, q = welch(expected, rate_hz, nperseg=256)
    np.testing.assert_allclose(10 * np.log10(p[2:-2] / q[2:-2]), 0, atol=1.0)
    assert 10 * np.log10(p.sum() / q.sum()) == pytest.approx(0, abs=0.2)
    assert f[-1] == rate_hz / 2


def test_the_command_makes_a_texture_that_renders_and_is_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = written(tmp_path / "Models_Cloth.xml"), tmp_path / "cloth.foten"
    assert _status(["import", str(source), "-o", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["texture"] == "Our Own Cloth"
    assert document["sizes"]["n_models"] == 5
    assert "friction is 0.3" in document["notes"]
    texture = read_texture(out)
    assert "no distribution" in texture.card["licence"]
    assert texture.card["split"] is None
    assert texture.trained_range("speed") == (0.0, 200.0)
    assert Renderer(out, rate=1000).render(speed_mm_s=0.0, force_n=1.0, n=500).max() == 0.0
    judged = evaluate(texture, simulate("linear-cloth", 14.0, seed=1)).document
    assert judged["split"] == "foreign"
    assert np.isfinite(judged["one_step"]["mae_scaled"])
    assert _status(["info", str(out)]) == 0
    assert "not trained here on a recording" in capsys.readouterr().out
    assert _status(["library", "add", str(source), "--library", str(tmp_path / "library")]) == 0
    assert read_texture(tmp_path / "library" / "Cloth.foten").card["sizes"]["n_models"] == 5
    assert _status(["import", str(source), "--rate", "1000", "-o", str(out)]) == 2
    assert "--rate is for recordings" in capsys.readouterr().err


def _edited(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("</modelSet>", "", "not XML, or it is truncated"),
        ("modelSet", "tapSet", "not XML"),
        ("mm/s<", "m/s<", "<SpeedUnits> is 'm/s', expected 'mm/s'"),
        ("<numMod>5", "<numMod>6", "says 6 models and the file holds 5"),
        ("<SampleRate>1000.0", "<SampleRate>0", "<SampleRate> is 0 Hz"),
        ("<SampleRate>1000.0", "<SampleRate>1e9", "<SampleRate> is 1e+09 Hz"),
        ("<value>1</value><value>2</value><value>5</value>", "<value>1</value><value>2</value>", "<tri> has 2 to 3"),
        ("<value>1</value><value>2</value><value>5", "<value>0</value><value>2</value><value>5", "expected 1 to 5"),
        ("<var>6.0", "<var>-6.0", "<var> is negative"),
        ("<var>6.0", "<var>loud", "<var> is 'loud', expected a number"),
        ("<gain>0.5", "<gain>nan", "<gain> is nan"),
        ("<var>6.0", "<var>6e300", "<var> is 6e+300, expected"),
        ("<tri ", "<tri/>" * 9 + "<tri ", "the file has 13 <tri>, expected 1 to 10 between"),
        ('<ARcoeff type="array"><value>1.0', '<ARcoeff type="array"><value>2.0', "begins with 2"),
    ],
)
def test_what_is_no_model_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, match: str
) -> None:
    source, out = _edited(written(tmp_path / "m.xml"), old, new), tmp_path / "m.foten"
    assert _status(["import", str(source), "-o", str(out)]) == 2
    message = capsys.readouterr().err.strip()
    assert match in message
    assert "\n" not in message
    assert not out.exists()


def test_zeros_outside_the_circle_keep_their_spectrum(tmp_path: Path) -> None:
    """A zero at radius r outside and one at 1/r with r times the gain have one spectrum."""
    models = read_models(written(tmp_path / "m.xml"))
    models.ma[:] = np.convolve([1.0, 1.6], [1.0, 0.3])
    texture, _ = imported_texture(models, "0" * 64)
    e = np.sqrt(models.variance[4]) * np.random.default_rng(0).standard_normal(60_000)
    expected = lfilter(models.gain[4] * models.ma[4], models.ar[4], e)
    played = Renderer(texture, seed=1).render(speed_mm_s=90.0, force_n=1.0, n=60_000)
    (_, p), (_, q) = (welch(x, 1000, nperseg=256) for x in (played, expected))
    np.testing.assert_allclose(10 * np.log10(p[2:-2] / q[2:-2]), 0, atol=1.0)


def test_a_filter_that_would_ring_for_ever_is_pulled_in_and_said(tmp_path: Path) -> None:
    models = read_models(written(tmp_path / "m.xml"))
    models.ar[4] = np.convolve(resonance(100.0, 1.001, 1000.0), resonance(300.0, 0.5, 1000.0))
    texture, decisions = imported_texture(models, "0" * 64)
    assert decisions == ["1 of 5 models had a pole further than 0.9995 from the middle: pulled in"]
    assert "pulled in" in texture.card["notes"]
    assert np.isfinite(Renderer(texture, rate=1000).render(speed_mm_s=90.0, force_n=1.0, n=5000)).all()
