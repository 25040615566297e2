"""Words: likeness orders, a regression recovers what words say, and a texture is what its spectrum says."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from foten.dsp.distance import log_spectral_distance
from foten.editing.describe import describe, rendered, spectrum
from foten.editing.texture_library import BANDS_HZ, Library, entry_of
from foten.models.texture_file import read_texture
from foten.runtime.renderer import EXAMPLE
from foten_lab.from_spectrum import Spectrum, interpolated, texture_of_spectrum
from foten_lab.words import (
    MIN_TEXTURES,
    Regression,
    SentenceEncoder,
    WordTable,
    encoder_of,
    fit,
    imagine,
    left_out_error,
    stem_of,
)
from test_cli import foten
from test_texture_library import entry

FOLDER = EXAMPLE.parent
SHAPE = Spectrum(BANDS_HZ[:15], 10 ** (-0.1 * np.abs(np.arange(15) - 6.0)), 100.0, 0.7, 0.9, 0.3)


def test_a_library_is_searched_by_words(tmp_path: Path) -> None:
    files = [str(FOLDER / f"{name}.foten") for name in ("towel", "jeans")]
    foten("library", "add", *files, "--library", tmp_path, "--tag", "woven")
    found = json.loads(foten("library", "search", "coarse denim", "--library", tmp_path, "--json")[0])
    assert found[0]["name"] == "jeans"


def test_a_texture_of_a_spectrum_has_that_spectrum_and_follows_its_powers() -> None:
    texture = texture_of_spectrum(SHAPE, 1000.0, "made", "from a test, not measured")
    hz, density = spectrum(rendered(texture, 100.0, 0.7, 60.0), 1000.0)
    inside = (hz > 25) & (hz < 440)
    assert log_spectral_distance(interpolated(hz, SHAPE)[inside], density[inside]) < 0.6  # of 60 s: 0.3 dB by chance
    levels = [20 * np.log10(rendered(texture, *at, 30.0).std()) for at in ((50.0, 0.7), (200.0, 0.7), (100.0, 2.8))]
    assert levels[1] - levels[0] == pytest.approx(0.9 * 20 * np.log10(4), abs=0.01)  # the same noise, times the law
    assert levels[2] - levels[0] == pytest.approx(20 * np.log10(2**0.9 * 4**0.3), abs=0.01)
    assert describe(texture).speed_exponent == pytest.approx(0.9)
    assert texture.evidence == "from a test, not measured"


def test_words_are_near_what_they_mean() -> None:
    table = WordTable()
    surfaces = ["sandpaper", "denim jeans", "leather", "artificial grass", "steel mesh"]
    vectors = np.array([table.encode(name) for name in surfaces])
    for words, meant in (("lawn", 3), ("corduroy trousers", 1), ("metal grid", 4), ("fine sandpaper", 0)):
        assert np.argmax(vectors @ table.encode(words)) == meant, words
    assert table.known("a Texture of Steel-Mesh 2 with qqqx") == ["steel", "mesh"]
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0)
    with pytest.raises(ValueError, match="no word of 'xqzw 12' is known, expected English words"):
        table.encode("xqzw 12")


def test_the_table_of_words_is_small_and_says_whose_it_is() -> None:
    from foten_lab import words

    assert words.TABLE.stat().st_size < 2e6
    assert "PDDL 1.0" in words.TABLE.with_suffix(".py").read_text(encoding="utf-8")


def test_a_sentence_encoder_that_is_missing_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sentence_transformers", None)
    with pytest.raises(ModuleNotFoundError):
        SentenceEncoder()
    assert (
        "pip install './packages/foten-lab[words]'"
        in foten("imagine", "linen", "--encoder", "none", "-o", "a.foten", status=2)[1]
    )


def test_a_regression_recovers_what_vectors_say() -> None:
    """A linear truth by the linear kernel; the mean where nothing is known."""
    rng = np.random.default_rng(0)
    vectors, weights = rng.normal(0, 1, (60, 5)), rng.normal(0, 1, (5, 19))
    values = vectors @ weights + 3.0
    expected, left = Regression(vectors[:50], values[:50], 0.0, 1e-6).at(vectors[55])
    np.testing.assert_allclose(expected, values[55], atol=1e-3)
    assert left < 0.01
    expected, left = Regression(vectors, values, 0.5, 1.0).at(np.full(5, 50.0))
    np.testing.assert_allclose(expected, values.mean(axis=0))
    assert left == 1.0


def test_a_name_is_left_out_with_its_namesakes() -> None:
    """Two of a name and one value each: with the namesake there is no error, without it there is."""
    vectors = np.repeat(np.eye(4), 2, axis=0)
    values = np.repeat(np.arange(4.0), 2)[:, None] * np.ones(19)
    together = [f"{i}" for i in range(8)]
    assert left_out_error(vectors, values, together, 0.3, 1e-6) < 0.01
    assert left_out_error(vectors, values, [f"{i // 2}" for i in range(8)], 0.3, 1e-6) > 0.5
    assert stem_of(entry("steel-mesh-1", 0.0)) == stem_of(entry("Steel Mesh 2", 0.0))


def test_words_over_a_library_make_a_texture(tmp_path: Path) -> None:
    """Metals bright and loud, cloths dull and soft: what is asked for is between, and nearer its own kind."""
    metals = ["steel", "iron", "brass", "copper", "aluminium", "bronze", "tin", "zinc"]
    cloths = ["cotton", "linen", "wool", "silk", "velvet", "denim", "felt", "flannel"]
    entries = [entry(f"{name} plate", -10.0, 0.2) for name in metals] + [
        entry(f"{name} cloth", -30.0, 1.5) for name in cloths
    ]
    library = Library(tmp_path, entries)
    assert fit(entries, encoder_of(None)).error_db < 0.5 * fit(entries, encoder_of(None)).mean_error_db
    textures = [imagine(text, library, encoder_of(None), 1000.0) for text in ("nickel plate", "muslin cloth")]
    metal, cloth = (describe(one.texture) for one in textures)
    assert metal.level_db > cloth.level_db + 6
    assert metal.centroid_hz > cloth.centroid_hz * 1.2
    assert textures[0].texture.evidence == 'from the words "nickel plate" over a library of 16 textures, not measured'
    assert textures[0].spread_db is not None
    assert 0 < textures[0].spread_db < 20
    with pytest.raises(ValueError, match=f"the library has 10 textures with known words, expected {MIN_TEXTURES}"):
        fit(entries[:10], encoder_of(None))
    with pytest.raises(ValueError, match="all 16 textures of the library are named 'muslin', expected others"):
        fit([entry(f"muslin-{k}", -10.0) for k in range(16)], encoder_of(None))
    assert (
        fit([entry(f"{'muslin' if k else 'velvet'}-{k}", -10.0 - k) for k in range(16)], encoder_of(None)).error_db > 0
    )


def test_few_textures_are_moved_and_that_is_called_a_guess(tmp_path: Path) -> None:
    path = str(tmp_path / "linen.foten")
    said = foten("imagine", "rough woven linen", "-o", path)[1]
    assert "a guess: 0 textures are too few to learn from, expected 15" in said
    texture = read_texture(path)
    assert texture.card["texture"] == "rough woven linen"
    assert texture.evidence.startswith('guessed from the words "rough woven linen": ')
    towel, library = [read_texture(FOLDER / "towel.foten")], Library(tmp_path, [])
    rough, smooth = (
        describe(imagine(text, library, encoder_of(None), 1000.0, towel).texture)
        for text in ("rough gritty stone", "smooth silky satin")
    )
    assert rough.level_db > smooth.level_db + 1
    said = foten("imagine", "rough woven linen", "-o", tmp_path / "fast.foten", "--rate", "2500", status=2)[1]
    assert "is of 1000 Hz: leave out the rate of 2500 Hz" in said
    assert not (tmp_path / "fast.foten").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["xqzw", "-o", "t.foten"], "no word of 'xqzw' is known"),
        (["linen"], "expected -o FILE"),
        (["linen", "-o", "t.foten", "--depth", "1"], "--depth"),
        (["linen", "-o", "t.foten", "--library", "none"], "no such library: none"),
        (["linen.wav", "-o", "t.foten"], "linen.wav is no picture"),
        (["height.png", "-o", "t.foten"], "expected --scale"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in foten("imagine", *arguments, status=2)[1]
    assert not list(tmp_path.iterdir())


def test_the_same_words_give_the_same_texture_in_another_process(tmp_path: Path) -> None:
    digests = set()
    for name in ("a", "b"):
        path = tmp_path / f"{name}.foten"
        code = "from foten.cli import main; main()"
        subprocess.run(
            [sys.executable, "-c", code, "imagine", "soft wool", "-o", str(path)], check=True, capture_output=True
        )
        digests.add(read_texture(path).sha256())
    assert len(digests) == 1
    assert entry_of(read_texture(path), "a.foten").evidence
