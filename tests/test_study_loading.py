"""A study file with what it names, and a database that has to be of this very study."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette")
from foten.runtime.renderer import Renderer
from foten.studio.levels import gains_db
from foten.study.loading import load_study
from test_study_server import study_file


def test_a_database_is_of_its_very_study(tmp_path: Path) -> None:
    path = study_file(tmp_path)
    database = tmp_path / "study.db"
    load_study(path).open_store(database, simulated=True).close()
    with pytest.raises(ValueError, match="holds simulated ratings, which stay apart"):
        load_study(path).open_store(database)
    text = path.read_text(encoding="utf-8")
    path.write_text(text + "\n# another comment\n", encoding="utf-8")
    with pytest.raises(ValueError, match="has changed since"):
        load_study(path).open_store(database, simulated=True)
    path.write_text(text, encoding="utf-8")
    load_study(path).open_store(database, simulated=True).close()
    texture = tmp_path / "artificial-grass-ar.foten"
    texture.write_bytes((tmp_path / "steel-mesh-1-dstn.foten").read_bytes())
    with pytest.raises(ValueError, match="ar of artificial-grass is another file than when"):
        load_study(path).open_store(database, simulated=True)
    texture.write_bytes(b"no texture")
    with pytest.raises(ValueError, match=r"artificial-grass-ar\.foten"):
        load_study(path)


def test_a_page_has_no_device_of_this_machine(tmp_path: Path) -> None:
    path = study_file(tmp_path)
    text = path.read_text(encoding="utf-8").replace('to = "page" ', 'to = "page"\ngain = 2.0')
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"\[output\] plays in the page, which has no device, gain or actuator"):
        load_study(path)


def test_levels_are_matched_and_stored(tmp_path: Path) -> None:
    study = load_study(study_file(tmp_path))
    listed = study.stimuli.listed
    assert max(abs(stimulus.gain_db) for stimulus in listed) > 0.3
    assert all(abs(stimulus.gain_db) <= 30 for stimulus in listed)
    for t, texture in enumerate(study.design.textures):  # with them, nothing is left to match
        renderers = [Renderer(file) for file in texture.files.values()]
        gains = [stimulus.gain_db for stimulus in listed if stimulus.texture == t]
        scales = [
            10 ** (db / 20) / r.native_texture.info.acceleration_sd for db, r in zip(gains, renderers, strict=True)
        ]
        np.testing.assert_allclose(gains_db(renderers, scales), 0.0, atol=1e-9)
    with study.open_store(tmp_path / "study.db") as store:
        assert list(store.stimuli().values()) == listed
    unmatched = load_study(study_file(tmp_path, match_levels="false", to='"null"'))
    assert {stimulus.gain_db for stimulus in unmatched.stimuli.listed} == {0.0}


def test_texts_that_no_speaker_has_read_are_a_doubt(tmp_path: Path) -> None:
    assert load_study(study_file(tmp_path)).doubts == []
    assert load_study(study_file(tmp_path, language="de")).doubts == [
        "the German texts have not been reviewed by a speaker"
    ]
