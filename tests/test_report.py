"""The report stands alone, shows the document's own numbers, and says what is missing."""

import copy
import json
import re
from dataclasses import asdict, replace
from functools import cache
from html.parser import HTMLParser

import numpy as np
import pytest

from conftest import SMALL, check_figures, exported
from foten.evaluate.evaluate import FREE_RUN_KEYS, SimulatorReference, evaluate
from foten.evaluate.free_run import scored
from foten.evaluate.one_step import one_step
from foten.evaluate.report import plots, signals
from foten.evaluate.report.page import page, write_report
from foten.evaluate.report.rows import REFERENCES, to_text
from foten.evaluate.report.signals import AUDIO_HZ, sounds
from foten.evaluate.report.verdict import cautions, headline, verdict
from foten.models.foten.sizes import FotenSizes
from foten.models.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Channel, Recording
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.simulation.simulate import simulate

N_BLOCKS, BLOCK, TRAIN, TEST = 8, 2000, (0, 1, 2, 5), (3, 4, 6, 7)
ONE_STEP = ("mae_scaled", "mae_m_s2", "gfc")
RUNS = ("free_run", "free_run_deterministic", "free_run_ar", "ceiling")


def _recording(rng, rate_hz):
    n = round((N_BLOCKS + 0.5) * BLOCK)
    t = np.arange(n) / rate_hz
    speed, force = 120 + 60 * np.sin(5 * t), 1 + 0.4 * np.sin(3 * t)
    vibration = np.convolve(rng.standard_normal(n + 7), np.ones(8) / 4, "valid") * speed / 120
    channels = {"acceleration": vibration, "speed": speed, "force": force}
    return Recording({name: Channel(samples, rate_hz) for name, samples in channels.items()})


@cache
def _judged(rate_hz=1000.0):
    """An untrained texture and its judgement, with two realisations for a ceiling and a bound of 0.1 sd."""
    rng = np.random.default_rng(0)
    recording, *others = (_recording(rng, rate_hz) for _ in range(3))
    config = PreprocessConfig(rate_hz=rate_hz, trim_ms=0, block_ms=1000 * BLOCK / rate_hz)
    texture = exported(
        *("foten", FotenSizes(**SMALL, excitation=True)),
        **{"texture": "denim", "rate_hz": rate_hz, "preprocess": asdict(config)},
        recording_sha256=recording.sha256(),
        split=asdict(Split(TRAIN, (), TEST, N_BLOCKS, BLOCK, "regrouped", 0)),
    )
    bound = np.full(N_BLOCKS * BLOCK, 0.1 * texture.scaling.sd[0])
    known = SimulatorReference([preprocess(other, config) for other in others], bound=bound)
    judgement = evaluate(texture, recording, known, seed=7)
    judgement.document["free_run_deterministic"]["level_corr"] = None
    judgement.document["reasons"]["free_run_deterministic.level_corr"] = "the level does not vary"
    return texture, judgement


def _texture(**card):
    texture, _ = _judged()
    return replace(texture, card={**texture.card, **card})


@pytest.fixture(scope="module")
def judged():
    return _judged()[1]


@pytest.fixture(scope="module")
def written(judged):
    return page(judged, _texture())


class _Page(HTMLParser):
    """Tags with their attributes, cells of the tables by row, and all text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.rows, self.words, self._cell = [], {}, [], None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append((tag, attrs))
        if tag == "tr":
            self.rows[attrs.get("id")] = self._row = []
        elif tag == "td":
            self._cell = {"value": None, "text": "", "why": None}
            self._row.append(self._cell)
        elif tag == "data":
            self._cell["value"] = float(attrs["value"])
        elif tag == "abbr":
            self._cell["why"] = attrs["title"]

    def handle_endtag(self, tag):
        if tag in ("td", "data", "abbr"):
            self._cell = self._cell if tag == "td" else None

    def handle_data(self, data):
        self.words.append(data)
        if self._cell is not None:
            self._cell["text"] += data


def _check(cell, value):
    if value is None:
        assert (cell["text"], cell["value"]) == ("–", None)
        assert cell["why"]
        return
    assert cell["value"] == value
    shown = cell["text"].replace("−", "-")
    digits = len(shown.partition(".")[2])
    assert float(shown) == pytest.approx(value, abs=0.5001 * 10**-digits)


def test_one_file_that_asks_for_nothing_else(written):
    assert "http" not in written
    assert "@import" not in written
    tags = _Page(written).tags
    assert not {tag for tag, _ in tags} & {"script", "link", "iframe", "object", "embed", "base", "img"}
    for _, attributes in tags:
        assert not [name for name in attributes if name.startswith("on")]
        for name in ("src", "href", "xlink:href", "srcset", "data"):
            assert attributes.get(name, "#").startswith(("data:", "#"))
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", written))


def test_identifiers_are_unique_and_every_reference_is_met(written):
    identifiers = re.findall(r'\sid="([^"]*)"', written)
    assert len(identifiers) == len(set(identifiers))
    used = re.findall(r'(?:url\(#|href="#)([^)"]*)', written)
    assert used
    assert set(used) <= set(identifiers)


def test_the_tables_show_the_numbers_of_the_document(judged, written):
    rows, document = _Page(written).rows, judged.document
    for key in FREE_RUN_KEYS:
        cells = rows[f"free_run.{key}"][1:]
        for run, cell in zip(RUNS, cells, strict=True):
            _check(cell, document[run][key])
    named = {"one_step": document["one_step"]} | {f"references.{k}": v for k, v in document["references"].items()}
    for key, scores in named.items():
        error, ratio, physical, fit = rows[key]
        for cell, figure in ((error, "mae_scaled"), (physical, "mae_m_s2"), (fit, "gfc")):
            hidden = (key, figure) == ("references.persistence", "gfc")  # 1.000 for any delay
            _check(cell, None if hidden else scores[figure])
        if scores["mae_scaled"] is not None:
            expected = 100 * (scores["mae_scaled"] / document["references"]["ar"]["mae_scaled"] - 1)
            assert float(ratio["text"].replace("−", "-").partition(" %")[0]) == pytest.approx(expected, abs=0.051)
    low, high = document["one_step"]["intervals"]["mae_scaled"]
    assert f"{low:.4f} … {high:.4f}" in written
    assert json.dumps(document["one_step"]["mae_m_s2"]) in written  # the raw document, in full


def test_a_terminal_shows_the_same_names_and_numbers(judged):
    document = judged.document
    lines = to_text(document).splitlines()
    for key, (name, _) in REFERENCES.items():
        error = document["references"][key]["mae_scaled"]
        shown = [re.split("  +", line)[1] for line in lines if re.match(re.escape(name) + "(:|  )", line)]
        assert shown == ([] if error is None else [f"{error:.4f}"])
    (distance,) = (line for line in lines if line.startswith("log-spectral distance [dB]"))
    shown = [float(cell) for cell in distance.split()[-4:]]
    assert shown == pytest.approx([document[run]["lsd_db"] for run in RUNS], abs=0.0501)
    assert "the ceiling is 2 further realisations of the same stroke" in to_text(document)


def test_a_terminal_shows_no_key_and_gathers_what_is_missing(judged):
    text = to_text(judged.document)
    assert not re.search(r"\w_\w|references\.", text)
    assert text.splitlines()[-2:] == [
        "One step, not computed: the model without its network (foten has no linear part); best AR (fewer than two training "
        "windows for each coefficient); persistence GFC (blind to delay: whatever repeats the last sample has 1); bound GFC (a "
        "bound on the error says nothing of the spectrum); bound of a window (known for simulated textures of the linear family "
        "alone).",
        "Free run, not computed: level correlation without excitation (the level does not vary).",
    ]
    text = to_text(_without(judged, "free_run_ar", "ceiling").document)
    assert text.endswith("AR(20), ceiling (left out); level correlation without excitation (the level does not vary).")


def test_what_is_unknown_is_a_dash_with_its_reason(judged, written):
    rows = _Page(written).rows
    words = "".join(_Page(written).words)
    expected = {
        "references.lattice": (0, "foten has no linear part"),
        "references.ar_best": (0, "fewer than two training windows for each coefficient"),
        "references.bound": (3, "a bound on the error says nothing of the spectrum"),
        "free_run.level_corr": (2, "the level does not vary"),
    }
    for row, (column, why) in expected.items():
        assert rows[row][column]["why"] == why
        assert words.count(why) >= 1  # as a footnote too: paper has no tooltips


def test_names_and_notes_cannot_break_the_page(judged):
    name, notes = '<b title="x">& µ</b>', "</pre><script>alert(1)</script>"
    document = copy.deepcopy(judged.document) | {"texture": name}
    document["reasons"]["references.lattice"] = '"><script>'
    parsed = _Page(page(replace(judged, document=document, synthesized={}), _texture(notes=notes, tool="<i>")))
    assert "script" not in {tag for tag, _ in parsed.tags}
    assert name in parsed.words
    assert notes in parsed.words
    assert parsed.rows["references.lattice"][0]["why"] == '"><script>'


def test_the_same_judgement_gives_the_same_bytes(judged, written, tmp_path):
    path = write_report(judged, _texture(), tmp_path)
    assert path == tmp_path / "report.html"
    assert path.read_bytes() == written.encode()
    assert json.loads((tmp_path / "evaluation.json").read_text())["seed"] == 7


@pytest.mark.parametrize("rate_hz", [1000.0, 2500.0, 10_000.0])
def test_both_players_have_one_gain(judged, rate_hz):
    judgement = replace(judged, trace=replace(judged.trace, rate_hz=rate_hz))
    recorded = judgement.trace.blocks(judgement.trace.acceleration)[list(TEST)]
    louder = replace(judgement, synthesized={"free_run": 2 * recorded[None]})
    first, second, full_scale = sounds(louder, "free_run")
    one, two = (np.frombuffer(data[44:], dtype="<i2").astype(float) for data in (first, second))
    np.testing.assert_allclose(two, 2 * one, atol=1.5)  # rounding to 16 bit
    assert np.abs(two).max() == pytest.approx(0.9 * 32767, abs=1)
    assert len(one) == pytest.approx(len(TEST) * 1600 / rate_hz * AUDIO_HZ, abs=len(TEST))
    power = np.square(recorded[:, scored(2000)]).mean()
    if rate_hz <= AUDIO_HZ:  # nothing is lost upwards but the fades
        assert np.square(one / 32767 * full_scale).mean() == pytest.approx(power, rel=0.05)


def test_a_tone_sounds_at_its_own_pitch(judged, written):
    assert written.count('src="data:audio/wav;base64,') == 2
    tone = np.sin(2 * np.pi * 130.0 * np.arange(BLOCK) / 1000.0)
    _, sound, _ = sounds(replace(judged, synthesized={"free_run": np.tile(tone, (1, len(TEST), 1))}), "free_run")
    samples = np.frombuffer(sound[44:], dtype="<i2")[: AUDIO_HZ * 8 // 10]
    peak = np.abs(np.fft.rfft(samples)).argmax() * AUDIO_HZ / len(samples)
    assert peak == pytest.approx(130.0, abs=AUDIO_HZ / len(samples))


def test_long_recordings_are_cut_to_eight_seconds_and_twelve_blocks(judged):
    many = replace(
        judged,
        trace=Trace(*(np.tile(c, 10) for c in judged.trace.stacked().T), 1000.0, 2000),
        blocks=tuple(range(60)),
        synthesized={"free_run": np.tile(judged.synthesized["free_run"], (1, 30, 1))},
    )
    first, second, _ = sounds(many, "free_run")
    assert len(first) == len(second) == 44 + 2 * 8 * AUDIO_HZ
    which = signals.shown_blocks(many)
    assert (len(which), which[0], which[-1]) == (12, 0, 59)


def test_the_figures_draw_what_was_scored(judged):
    """The pooled spectra give the document's distance, the levels its bias, the bars its bands."""
    _, pooled = signals.densities(judged)
    floor = 1e-12 * pooled["recorded"].max()
    for name in RUNS:
        ratio = 10 * np.log10(pooled["recorded"] / np.maximum(pooled[name], floor))
        assert np.sqrt(np.square(ratio).mean()) == pytest.approx(judged.document[name]["lsd_long_db"])
        assert signals.frame_errors(judged, name).mean() == pytest.approx(judged.document[name]["level_bias_db"])
    axes = plots.bands(judged).axes[0]
    errors = [x for name in ("free_run", "free_run_ar", "ceiling") for x in judged.document[name]["band_errors_db"]]
    assert [bar.get_height() for bar in axes.patches] == pytest.approx(errors)
    (line, _), *_ = (axes.lines for axes in plots.waveform(judged).axes)
    block = judged.blocks[signals.typical_block(judged)]
    np.testing.assert_array_equal(line.get_ydata(), judged.trace.acceleration[2000 * block + 400 :][:400])


def test_the_figures_are_as_they_were_looked_at(judged, texture):
    """At rest, where no frame says which force and speed are usual; and of bands without a bin."""
    errors = [None, *judged.document["free_run"]["band_errors_db"][1:]]
    few = _without(judged, "ceiling", free_run=judged.document["free_run"] | {"band_errors_db": errors})
    at_rest = replace(judged, trace=replace(judged.trace, speed=np.zeros_like(judged.trace.speed)))
    drawn = {draw.__name__: draw(judged) for draw in (plots.waveform, plots.spectrum, plots.bands, plots.over_time)}
    drawn |= {"bands-few": plots.bands(few), "conditions": plots.conditions(judged, _texture())}
    drawn |= {"reach": plots.reach(judged, texture), "reach-at-rest": plots.reach(at_rest, texture)}
    check_figures({f"report-{name}": figure for name, figure in drawn.items()})


def test_figures_of_a_fast_texture_reach_half_its_rate():
    """What is above 1 kHz is drawn beside what is scored, and the axes say which is which."""
    _, judged = _judged(10_000.0)
    (axes,) = plots.spectrum(judged).axes
    assert axes.get_xlim() == (20, 5000)
    assert "up to half the rate; scored from 20 to 1000 Hz" in axes.get_xlabel()
    frequencies, _ = signals.densities(judged, unscored=True)
    assert max(line.get_xdata().max() for line in axes.lines) == frequencies[-1] == 5000


def test_beyond_the_recorded_range_the_figure_shows_the_law(judged, texture):
    """The card's powers, 0.7 of speed and 0.4 of force, above the trained range; frames of the recording within it."""
    figure = plots.reach(judged, texture)
    for axes, (low, high), power in zip(figure.axes, ((8.0, 220.0), (0.3, 2.5)), (0.7, 0.4), strict=True):
        recorded, beyond, inside = axes.lines
        assert (inside.get_xdata().min(), inside.get_xdata().max()) == (low, high)
        values, levels = beyond.get_data()
        above = values >= high
        assert above.sum() >= 2
        grown = (levels[above][-1] - levels[above][0]) / np.log10(values[above][-1] / values[above][0])
        assert grown == pytest.approx(20 * power, abs=1.0)  # an RMS of 2 s
        assert recorded.get_xdata().size > 10
    plain = exported("foten")
    assert plots.reach(judged, plain) is None


def test_spectrograms_share_a_scale_and_show_a_tone_where_it_is(judged):
    tone = np.sin(2 * np.pi * 200.0 * np.arange(2000) / 1000.0)
    figure = plots.over_time(replace(judged, synthesized={"free_run": np.tile(tone, (1, len(TEST), 1))}))
    recorded, synthesized = (axes.images[0] for axes in figure.axes[:2])
    assert recorded.get_clim() == synthesized.get_clim()
    cells = np.asarray(synthesized.get_array())
    low, high = synthesized.get_extent()[2:]
    bin_hz = (high - low) / len(cells)
    centre = (low + (cells.argmax(axis=0) + 0.5) * bin_hz).reshape(len(TEST), -1)
    np.testing.assert_allclose(centre[:, 4:-4], 200.0, atol=bin_hz / 2)  # mirroring bends the tone at the borders
    assert figure.axes[0].lines[0].get_xdata()[0] == pytest.approx(1.6)  # the border of two blocks


def _without(judgement, *names, **changed):
    document = copy.deepcopy(judgement.document) | {name: dict.fromkeys(FREE_RUN_KEYS) for name in names} | changed
    document["reasons"] |= dict.fromkeys(names, "left out")
    synthesized = {name: signal for name, signal in judgement.synthesized.items() if name not in names}
    return replace(judgement, document=document, synthesized=synthesized)


def test_without_excitation_the_silent_run_stands_in_and_is_called_so(judged):
    judgement = _without(judged, "free_run", model="foten")
    text = page(judgement, _texture())
    assert signals.shown_run(judgement) == "free_run_deterministic"
    spectrum, level = verdict(judgement.document)[1:3]
    assert spectrum.tone == level.tone == "bad"
    assert "without excitation" in spectrum.sentence
    assert "silent" in level.sentence
    assert _Page(text).rows["free_run.lsd_db"][1]["why"] == "left out"
    assert "synthesized (without excitation)" in text


def test_a_foreign_recording_without_ceiling_or_linear_fit_is_reported(judged):
    judgement = _without(judged, "free_run_ar", "ceiling", split="foreign", split_sha256=None)
    for name in ("ar", "ar_scheduled", "ar_best"):
        judgement.document["references"][name] = dict.fromkeys(ONE_STEP) | {"order": None, "scheduled": None}
    judgement.document["reasons"] = {"references.ar": "no training blocks to fit on"}
    text = page(judgement, _texture(split=asdict(Split((99,), (3,), (4,), 100, BLOCK, "regrouped", 0))))
    assert any("not the recording" in note for note in cautions(judgement.document))
    step, spectrum, *_ = verdict(judgement.document)
    assert "% above persistence" in step.sentence
    assert (spectrum.tone, spectrum.beside) == ("unknown", "no ceiling known")
    assert _Page(text).rows["references.ar_best"][0]["why"] == "no training blocks to fit on"


def test_blocks_too_short_to_score_leave_dashes_and_words(judged):
    document = copy.deepcopy(judged.document)
    document |= {name: dict.fromkeys(FREE_RUN_KEYS) for name in RUNS} | {"one_step": dict.fromkeys(ONE_STEP)}
    document["references"] = {name: dict.fromkeys(ONE_STEP) for name in REFERENCES}
    document["references"]["ar_best"].update(order=None, scheduled=None)
    document["reasons"] = {"one_step": "blocks of 70 samples", "free_run": "too short for a spectrum"}
    parsed = _Page(page(replace(judged, document=document, synthesized={}), _texture()))
    assert not [tag for tag, _ in parsed.tags if tag in ("svg", "audio", "data")]
    assert parsed.rows["references.ar"][0]["why"] == "blocks of 70 samples"
    assert parsed.rows["free_run.kurtosis"][4]["why"] == "too short for a spectrum"
    assert {finding.tone for finding in verdict(document)} == {"unknown"}


@pytest.mark.parametrize(
    ("error", "best", "tone", "words"),
    [
        (0.5, 0.9, "good", "50 % below AR(20)"),
        (0.995, 1.0, "even", "within 1 % of AR(20)"),
        (1.3, 1.0, "bad", "30 % above AR(20). A linear predictor does this better."),
        (0.8, 0.5, "even", "The best linear predictor, AR(20), does this better."),
    ],
)
def test_the_verdict_says_who_is_better(judged, error, best, tone, words):
    document = copy.deepcopy(judged.document)
    document["references"]["bound"] = dict.fromkeys(ONE_STEP)
    document["one_step"]["mae_scaled"] = error
    document["references"]["ar"]["mae_scaled"] = 1.0
    document["references"]["ar_best"] |= {"mae_scaled": best, "order": 20}
    document["one_step"]["intervals"]["mae_to_ar"] = [error - 0.01, error + 0.01]
    step = verdict(document)[0]
    assert step.tone == tone
    assert words in step.sentence


def _good(judged):
    """A document whose four findings are good, and whose data bear it."""
    document = copy.deepcopy(judged.document)
    document["references"]["bound"] = dict.fromkeys(ONE_STEP)
    document["references"]["ar"]["mae_scaled"] = document["references"]["ar_best"]["mae_scaled"] = 1.0
    document["one_step"] |= {"mae_scaled": 0.9, "intervals": {"mae_scaled": [0.6, 1.2], "mae_to_ar": [0.85, 0.95]}}
    figures = {"lsd_db": 2.4, "level_bias_db": -0.3, "level_error_db": 0.8, "level_corr": 0.9}
    ends = {"lsd_db": [2.0, 2.8], "level_bias_db": [-0.9, 0.3], "level_corr": [0.8, 1.0]}
    document["free_run"] |= figures | {"intervals": ends}
    document["ceiling"] |= {"lsd_db": 2.3, "level_corr": 0.95}
    document["free_run_ar"]["lsd_db"] = 3.0
    return document


@pytest.mark.parametrize(
    ("which", "run", "key", "ends"),
    [
        (0, "one_step", "mae_to_ar", [0.79, 1.01]),  # no difference from AR(20) is inside
        (1, "free_run", "lsd_db", [1.0, 3.8]),  # as bad as 1.65 × the ceiling
        (2, "free_run", "level_bias_db", [-3.6, 3.0]),
        (3, "free_run", "level_corr", [0.4, 1.0]),
        *((which, run, key, None) for which, run, key in ((0, "one_step", "mae_to_ar"), (1, "free_run", "lsd_db"))),
        *((which, "free_run", key, None) for which, key in ((2, "level_bias_db"), (3, "level_corr"))),
    ],
)
def test_no_mark_praises_what_the_data_do_not_bear(judged, which, run, key, ends):
    document = _good(judged)
    assert [finding.tone for finding in verdict(document)] == ["good"] * 4
    document[run]["intervals"] = {**document[run]["intervals"], key: ends}
    finding = verdict(document)[which]
    assert finding.tone == "unknown"
    assert finding.beside.startswith("too little data to say")
    assert finding.sentence.endswith("its 95 % interval reaches further.") == (ends is not None)
    assert [one.tone for one in verdict(document)].count("good") == 3


def test_the_error_to_ar_has_an_interval_of_its_own(judged, written):
    """On the same blocks: an error of always 1.1 times AR(20)'s has an interval of no width, whatever the blocks are like."""
    rng = np.random.default_rng(1)
    errors = rng.standard_normal((6, 50)) * np.arange(1, 7)[:, None]
    figures = one_step(np.zeros((6, 50)), 1.1 * errors, 1.0, errors)
    assert figures["mae_to_ar"] == pytest.approx(1.1)
    assert figures["intervals"]["mae_to_ar"] == pytest.approx([1.1, 1.1])
    assert np.ptp(figures["intervals"]["mae_scaled"]) > 1
    low, high = (100 * (end - 1) for end in judged.document["one_step"]["intervals"]["mae_to_ar"])
    ends = f"{low:+.1f} … {high:+.1f} %".replace("-", "−")
    assert f"<small>{ends}</small>" in written


def _off(judged, errors):
    """A judgement in which the frames of each third of the speeds are off by some dB."""
    recorded, speed, _ = judged.trace.picked(judged.blocks)
    slow = np.convolve(speed.ravel(), np.ones(80) / 80, "same").reshape(speed.shape)  # of about a frame
    edges = np.quantile(slow[:, scored(BLOCK)], [1 / 3, 2 / 3])
    gains = 10 ** (np.asarray(errors)[np.searchsorted(edges, slow)] / 20)
    run = {**judged.document["free_run"], "lsd_db": 0.9 * judged.document["ceiling"]["lsd_db"]}
    synthesized = {"free_run": (gains * recorded)[None]}
    return replace(judged, synthesized=synthesized, document={**judged.document, "free_run": run})


@pytest.mark.parametrize(
    ("errors", "words"),
    [
        (
            (0, 0, 0),
            r"Usable with care from \d+ to \d+ mm/s, where it was judged: level within 0.1 dB at each of them, "
            r"spectrum 2.\d dB away \(a second stroke's: 2.\d dB\); a step ahead a simple predictor is better; "
            r"only 4 blocks judge it.",
        ),
        ((0, 0, 6), r"Usable below \d+ mm/s; from \d+ to \d+ mm/s it is 6 dB too loud: record more strokes there."),
        ((-5, 0, 0), r"Usable above \d+ mm/s; from \d+ to \d+ mm/s it is 5 dB too soft: record more strokes there."),
        ((0, 5, 0), r"Usable with care; from \d+ to \d+ mm/s it is 5 dB too loud"),
        ((5, 5, 5), "Not usable yet: its level is off at every speed. Record again"),
        ((-40, -40, -40), "Not usable: left to itself it falls silent."),
    ],
)
def test_the_first_line_says_what_it_is_good_for(judged, errors, words):
    """Files and hashes came first, and filled a phone's screen."""
    assert re.match(words, headline(_off(judged, errors)))
    text = page(judged, _texture())
    assert text.index("class=headline") < text.index('id="verdict"') < text.index('id="about"')


@pytest.mark.parametrize(
    ("speed", "words"), [(0.0, "Not judged: the tool hardly moves"), (80.0, "Usable with care from 80 to 80")]
)
def test_the_first_line_of_a_hand_of_one_speed(judged, speed, words):
    still = replace(judged.trace, speed=np.full_like(judged.trace.speed, speed))
    assert headline(replace(_off(judged, (0, 0, 0)), trace=still)).startswith(words)


def test_the_first_line_does_not_praise_another_surface(judged):
    """A towel judged on noise was "usable from 101 to 110 mm/s", a step ahead of which it was worse than silence."""
    document = {**judged.document, "split": "foreign", "one_step": {**judged.document["one_step"], "mae_scaled": 2.0}}
    assert headline(replace(judged, document=document)).startswith("Not this surface, or other sensors")


def test_the_waveform_error_stands_beside_that_of_silence(judged):
    """The paper's readers look for it: silence wins, and the sentence says why that is nothing."""
    document = judged.document
    recorded, part = judged.trace.picked(judged.blocks)[0], scored(judged.trace.block)
    sd = document["sd_m_s2"]
    error = np.abs(judged.synthesized["free_run"][:, :, part] - recorded[:, part]).mean() / sd
    assert document["free_run"]["mae_scaled"] == pytest.approx(error)
    assert document["free_run"]["mae_scaled_silence"] == pytest.approx(np.abs(recorded[:, part]).mean() / sd)
    assert f"mean absolute error is {error:.2f} sd; silence has" in to_text(document)
    errors, silence = np.abs(judged.from_warm_start["stored"] - recorded), np.abs(recorded)
    first, later = (errors[..., span].mean() / silence[..., span].mean() for span in (slice(100), slice(100, 400)))
    assert (
        f"From the warm start it is {first:.2f} times that of silence in the first 100 ms, and {later:.2f}"
        in to_text(document)
    )
    assert document["references"]["persistence"]["gfc"] is not None  # 1.000, which looked like a victory
    (row,) = (line for line in to_text(document).splitlines() if line.startswith("persistence"))
    assert row.rstrip().endswith("–")


def test_the_verdict_reads_the_free_run(judged):
    document = _good(judged)
    document["free_run"]["n_saturated"] = 3
    _, spectrum, level, dynamics = verdict(document)
    assert spectrum.beside == "1.04 × the ceiling's 2.30 dB"
    assert "0.60 dB below AR(20)" in spectrum.sentence
    assert level.sentence.startswith("Level: 0.3 dB too low")
    assert {spectrum.tone, level.tone, dynamics.tone} == {"good"}
    assert any("saturator cut 3 samples" in note for note in cautions(document))
    document["free_run"]["level_bias_db"] = None
    document["reasons"]["free_run.level_bias_db"] = "what is scored holds no frame"
    assert verdict(document)[2].sentence == "Level: not measured (what is scored holds no frame)."
    assert headline(replace(judged, document=document)) == "Not judged: what is scored holds no frame."
    document["free_run_ar"]["lsd_db"] = 2.0  # a baseline is closer: never a full mark
    assert verdict(document)[1].tone == "even"
    document["ceiling"]["level_corr"] = -0.2  # says nothing of this hand
    assert verdict(document)[3].tone == "unknown"


def test_relative_units_are_called_so_in_terminal_and_page(judged, texture) -> None:
    relative = replace(judged, document={**judged.document, "unit": "relative"})
    assert "error [relative]" in to_text(relative.document)
    assert "m/s²" not in to_text(relative.document)
    shown = re.sub(r'"data:[^"]*"', "", page(relative, texture))
    assert "error <i>[relative]</i>" in shown
    assert "m/s²" not in shown


def test_a_page_names_a_texture_printable_and_short(judged, texture) -> None:
    """Its card is in the page too, as JSON."""
    evil = "\x1b[2J\u202e" + "x" * 1_000_000
    card = {**texture.card, "texture": evil, "notes": evil, "licence": evil}
    shown = page(replace(judged, document={**judged.document, "texture": evil}), Texture(card, texture.tensors))
    before_the_card = shown[: shown.index('id="raw"')]
    assert "x" * 100 in before_the_card
    assert "x" * 2001 not in before_the_card
    assert not {"\x1b", "\u202e"} & set(before_the_card)


def test_a_relative_recording_is_not_judged_by_a_texture_in_units(texture) -> None:
    recording = replace(simulate("jeans", 14.0), calibrated=False)
    with pytest.raises(ValueError, match="the recording is in relative units and the other in m/s²"):
        evaluate(texture, recording)


@pytest.mark.parametrize(
    ("found", "person", "control", "tone", "of_person"),
    [
        (0.58, 0.53, 0.49, "good", "good"),
        (0.7, 0.71, 0.62, "good", "good"),
        (0.78, 0.73, 0.5, "even", "even"),
        (0.79, 0.78, 0.5, "even", "bad"),
        (0.97, 0.9, None, "bad", "bad"),
    ],
)
def test_listeners_are_findings_beside_their_controls(judged, found, person, control, tone, of_person):
    scores = {f"listener_auc{kind}{of}": control for kind in ("", "_waveform", "_person") for of in ("", "_control")}
    scores |= {"listener_auc": found, "listener_auc_waveform": 0.8, "listener_auc_person": person}
    scores |= {"listener_s": 236.0, "listener_control_of": "another"}
    document = judged.document | {"listener": scores}
    *_, ideal, limited = verdict(document)
    assert (ideal.title, ideal.tone, ideal.figure) == ("Listener", tone, f"{found:.2f}")
    assert (limited.title, limited.tone, limited.figure) == ("A person's limits", of_person, f"{person:.2f}")
    for area, finding in ((found, ideal), (person, limited)):
        assert f"right in {100 * area:.0f} % of pairs" in finding.sentence
        assert ("of two true vibrations" in finding.sentence) == (control is not None)
    assert "is there any difference?" in ideal.sentence
    assert "would someone notice" in limited.sentence
    text = to_text(document)
    assert "Listener: area under its curve over 236 s" in text
    assert f"{found:.3f}" in text
    assert re.search(rf"with a person's limits +{person:.3f}", text)


def test_a_listener_that_could_not_be_asked_says_why(judged):
    reasons = judged.document["reasons"] | {"listener": "12 s to listen to, expected at least 40"}
    document = judged.document | {"listener": None, "reasons": reasons}
    *_, finding = verdict(document)
    assert (finding.title, finding.tone) == ("Listener", "unknown")
    assert "12 s to listen to" in finding.sentence
    assert "Listener, not computed" in to_text(document)
