"""A surface captured in a browser: its microphone hears a simulated surface, synthetic events stroke it, a texture comes of it.

The pen's clock runs 50 ppm fast and 80 ms late.
"""

from __future__ import annotations

import base64
import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io.wavfile
import scipy.signal

from foten.cli.train_capture import train_recording
from foten.datasets.hdf5 import load_recording
from foten.datasets.importing import read_stroke
from foten.dsp import Array
from foten.evaluate.evaluate import evaluate
from foten.models.texture_file import read_texture
from foten.recording.inspection import inspect_recording
from foten.recording.recording import Recording
from foten.simulation.simulated_capture import BEGIN_S, CUE_S, FULL_SCALE, SOUND_HZ, SimulatedCapture, simulate_capture
from foten.studio.capture_server import in_order
from test_studio_page import CHROMIUM, SHOTS, chromium, look, until
from test_studio_server import serving

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt install chromium")]
DELAY_S, DRIFT = 0.08, 50e-6  # of the pen's clock
EVENTS_HZ = 200.0
FAKE_MICROPHONE = ("--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream")
CAPTURE = "window.studio.capture"
BUSY_MS = 200.0  # between two turns of the page, of which each is 5 ms: above, the machine is too busy

# Dispatches the plan by the page's own clock, ±20 % of a step early or late, from when the sound began.
PERFORM = """({ plan, end, began, delay, drift, hz }) => {
  const canvas = document.querySelector("#surface"), box = canvas.getBoundingClientRect(), mm = window.studio.capture.pad.mmPerPx;
  canvas.setPointerCapture = () => {};
  let was = 0, i = 0;
  const say = (type, x, y, pressure) => canvas.dispatchEvent(new PointerEvent(type, { pointerId: 7, pointerType: "pen", pressure,
    clientX: box.left + 20 + x / mm, clientY: box.top + 20 + y / mm, bubbles: true, button: 0, buttons: 1 }));
  window.performing = true;
  const step = () => {
    const levels = window.studio.capture.levels;
    window.latest = Math.max(window.latest ?? 0, performance.now() - (window.before ?? performance.now()));
    window.before = performance.now();
    window.lostSound = levels ? levels.lost > 0 : window.lostSound;
    const at = (performance.now() - began - 1000 * delay) / 1000 * (1 + drift);
    while (i + 1 < plan.length && plan[i + 1][0] <= at) i++;
    const [, x, y, pressure] = plan[i];
    if (pressure > 0 && was === 0) say("pointerdown", x, y, pressure);
    else if (pressure > 0) say("pointerrawupdate", x, y, pressure);
    else if (was > 0) say("pointerup", x, y, 0);
    was = pressure;
    window.strokesEnded = at > end;
    if (i + 1 < plan.length) setTimeout(step, 1000 / hz * (0.8 + 0.4 * Math.random()));
    else window.performing = false;
  };
  step();
}"""


@contextlib.contextmanager
def opened_capture(browser: Any, link: str) -> Iterator[Any]:
    context = browser.new_context(permissions=["microphone"])
    page = context.new_page()
    page.goto(link)
    page.wait_for_selector("html[data-ready]")
    yield page
    context.close()


def perform(page: Any, performance: SimulatedCapture) -> None:
    """Play the part of the hand; the sound runs since the page began to listen."""
    page.click("#capture-one")
    page.fill("#called", "Test mesh")
    page.click("#set-up summary")
    page.fill("#sensor", "1")
    page.fill("#full", str(FULL_SCALE))
    knock = f"{CAPTURE}.peaks?.find(([, peak]) => peak > 0.1)"
    until(page, f"Boolean({knock})", 2 * BEGIN_S)
    began = 1000 * (page.evaluate(f"{knock}[0]") - BEGIN_S + CUE_S)
    page.click("#go")
    plan = {"plan": performance.plan[::2].round(4).tolist(), "end": performance.strokes_s[1], "began": began}
    page.evaluate(PERFORM, {**plan, "delay": DELAY_S, "drift": DRIFT, "hz": EVENTS_HZ})


def shot(page: Any, name: str) -> None:
    SHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SHOTS / f"{name}.png")


@pytest.fixture
def performance() -> SimulatedCapture:
    return simulate_capture("steel-mesh-1", 30.0)


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("captures")


@pytest.fixture(scope="module")
def studio_link(captures: Path) -> Iterator[str]:
    with serving("--captures", str(captures)) as (_, link):
        yield link


@pytest.fixture
def browser(tmp_path: Path, performance: SimulatedCapture) -> Iterator[Any]:
    """A browser whose microphone hears the performance."""
    performance.write(tmp_path / "performance", np.random.default_rng(0))
    microphone = f"--use-file-for-fake-audio-capture={tmp_path / 'performance' / 'sound.wav'}%noloop"
    with chromium(*FAKE_MICROPHONE, microphone) as browser:
        yield browser


def lag_s(recording: Recording, sound: Array, rate_hz: int, performance: SimulatedCapture) -> float:
    """How much later than in truth the pen is in a recording; where its sound begins in the true one is seen in both."""
    known = scipy.signal.resample_poly(performance.sound, rate_hz // 300, round(SOUND_HZ) // 300)
    n = 1 << (known.size + sound.size).bit_length()
    product = np.fft.rfft(known, n) * np.conj(np.fft.rfft(sound, n))
    begins = int(np.fft.irfft(product, n)[: known.size].argmax()) / rate_hz
    x, force = recording["position_x"], recording["force"]
    plan, low = performance.plan, performance.strokes_s[0] - begins
    # Only where the pen touches: in the air a tablet tells no place. Each stroke is told from where the last one ended.
    touches = force.samples > 0
    speed = np.gradient(x.samples, x.times)
    inside = touches & np.roll(touches, 1) & np.roll(touches, -1) & (x.times > low + 0.1)
    true = np.gradient(plan[:, 1], plan[:, 0])
    lags = np.arange(-0.05, 0.05, 0.0002)
    at = x.times[inside] + begins
    missed = [np.abs(speed[inside] - np.interp(at - lag, plan[:, 0], true)).mean() for lag in lags]
    return float(lags[int(np.argmin(missed))])


def judged(path: Path, recording: Recording) -> float:
    """The log-spectral distance [dB] of a texture's free run over a recording that it was not trained on."""
    return float(evaluate(read_texture(path), recording).document["free_run"]["lsd_db"])


@pytest.fixture(scope="module")
def quiet_browser() -> Iterator[Any]:
    """A browser whose microphone beeps once a second."""
    with chromium(*FAKE_MICROPHONE) as browser:
        yield browser


def test_it_can_be_read_and_used_by_all(quiet_browser: Any, studio_link: str) -> None:
    with opened_capture(quiet_browser, studio_link) as page:
        page.click("#capture-one")
        until(page, "document.querySelectorAll('#inputs option').length > 0")
        for step in ("set-up", "tap-in", "stroke", "training", "failed"):
            page.evaluate(f"(step) => {{ {CAPTURE}.enter(step); {CAPTURE}.draw(); }}", step)
            assert look(page, f"capture-{step}", part="#capture") == []
            bar = page.evaluate("document.querySelector('#learning').position")
            assert step != "training" or bar == -1  # it moves until the server says how far it is


def test_the_page_shows_what_to_do_and_what_a_mouse_lacks(quiet_browser: Any, studio_link: str) -> None:
    """Nothing said that the microphone has to be on the pen, and "Parts of the sound are missing" stood before Begin."""
    with opened_capture(quiet_browser, studio_link) as page:
        page.click("#capture-one")
        until(page, "document.querySelectorAll('#inputs option').length > 0")
        assert "contact microphone to the pen" in page.inner_text("#how")
        page.evaluate(f"{CAPTURE}.levels.lost = 3")
        page.wait_for_timeout(200)
        assert "missing" not in page.inner_text("#trouble")
        box = page.locator("#surface").bounding_box()
        page.mouse.click(box["x"] + 40, box["y"] + 40)
        until(page, "document.querySelector('#trouble').textContent.startsWith('A mouse has no pressure')")
        # The heading stays where it is whatever it says.
        tops = []
        for advice in ("Stroke", "Slower, lighter", "Faster, harder"):
            page.evaluate(f"{CAPTURE}.enter('stroke')")
            page.evaluate("(advice) => (document.querySelector('#step').textContent = advice)", advice)
            tops.append([page.locator(part).bounding_box()["y"] for part in ("#step", "#field")])
        assert tops[0] == tops[1] == tops[2]
        page.evaluate(f"{CAPTURE}.enter('set-up')")
        # A quarter of the scale shows the gradient's first quarter, which is not red.
        # Drawn and read at once: what the input holds comes between otherwise.
        set_level = f"{CAPTURE}.levels.rms = 1e-3; {CAPTURE}.shown = -60; {CAPTURE}.draw();"
        read = "parseFloat(document.querySelector('#hears i').style.clipPath.split(' ')[1])"
        clipped = page.evaluate(f"() => {{ {set_level} return {read}; }}")
        assert 70 <= clipped <= 85


def test_an_input_is_asked_to_filter_nothing_and_refused_where_it_does(quiet_browser: Any, studio_link: str) -> None:
    with opened_capture(quiet_browser, studio_link) as page:
        page.click("#capture-one")
        until(page, f"Boolean({CAPTURE}.stream)")
        settings = page.evaluate(f"{CAPTURE}.stream.getAudioTracks()[0].getSettings()")
        assert [settings[name] for name in ("echoCancellation", "noiseSuppression", "autoGainControl")] == [False] * 3
        page.click("#guide .close")
        until(page, f"{CAPTURE}.stream === null")
        page.evaluate(
            """() => {
              const given = MediaStreamTrack.prototype.getSettings;
              MediaStreamTrack.prototype.getSettings = function () { return { ...given.call(this), noiseSuppression: true }; };
            }"""
        )
        page.click("#capture-one")
        until(page, f"{CAPTURE}.step === 'failed'")
        until(page, "document.querySelector('#trouble').textContent.includes('does not turn off noise suppression')")


LEVELS = """async ({ pause, stroke }) => {
  const { Levels } = await import("/levels.js"), levels = new Levels(48000);
  const part = (text, down) => {
    const samples = new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
    for (let i = 0; i + 896 <= samples.length; i += 896) levels.add(samples.slice(i, i + 896), down);
  };
  part(pause, false);
  part(stroke, true);
  return levels.trouble;
}"""


def test_what_is_wrong_with_an_input_is_said(quiet_browser: Any, studio_link: str) -> None:
    rng = np.random.default_rng(0)
    noise, t = rng.standard_normal(96_000), np.arange(96_000) / 48_000
    sounds = {
        "quiet": 1e-3 * noise,
        "loud": 0.1 * noise,
        "clipped": np.clip(noise, -1, 1),
        "silent": 1e-6 * noise,
        "faint": 1.5e-3 * noise,
        "lost": 0.1 * noise * ((t < 1.0) | (t > 1.1)),
        "hum": 1e-3 * noise + 0.03 * np.sin(2 * np.pi * 50 * t),
    }
    texts = {name: base64.b64encode(samples.astype("<f4").tobytes()).decode() for name, samples in sounds.items()}
    with opened_capture(quiet_browser, studio_link) as page:
        for pause, stroke, expected in (
            ("quiet", "clipped", "It clips"),
            ("silent", "silent", "The input is silent"),
            ("quiet", "faint", "hardly louder than the room"),
            ("quiet", "lost", "Parts of the sound are missing"),
            ("hum", "loud", "It hums at 50 Hz"),
        ):
            assert expected in page.evaluate(LEVELS, {"pause": texts[pause], "stroke": texts[stroke]})
        assert page.evaluate(LEVELS, {"pause": texts["quiet"], "stroke": texts["loud"]}) is None


# Stands in for the server: what the page sends is kept, and a test answers.
SOCKETS = """() => {
  window.sockets = [];
  window.said = [];
  window.WebSocket = class {
    static CONNECTING = 0;
    constructor() {
      Object.assign(this, { readyState: 0, texts: [], n_bytes: 0, closed: false });
      sockets.push(this);
      setTimeout(() => { this.readyState = 1; this.onopen?.(); });
    }
    send(message) {
      if (typeof message === "string") this.texts.push(JSON.parse(message));
      else this.n_bytes += message.byteLength;
    }
    close() { this.closed = true; }
    answer(document) { this.onmessage?.({ data: JSON.stringify(document) }); }
  };
  const { capture } = window.studio;
  capture.onTexture = (listed, done) => window.said.push([listed.file, done]);
  capture.say = (text) => window.said.push(text);
}"""


def begun(page: Any, name: str) -> None:
    """Open the dialog and begin a capture."""
    page.evaluate(f"document.querySelector('#capture').open || {CAPTURE}.show()")
    until(page, f"Boolean({CAPTURE}.levels)")
    page.fill("#called", name)
    page.click("#go")
    until(page, f"{CAPTURE}.step === 'tap-in' && window.sockets.at(-1).n_bytes > 0")


def answer(page: Any, socket: int, **document: Any) -> None:
    page.evaluate("([socket, document]) => window.sockets[socket].answer(document)", [socket, document])


def test_a_capture_that_still_learns_is_not_lost_to_the_next_one(quiet_browser: Any, studio_link: str) -> None:
    with opened_capture(quiet_browser, studio_link) as page:
        page.evaluate(SOCKETS)
        is_open = "document.querySelector('#capture').open"
        for i, name in enumerate(("first", "second", "third")):
            begun(page, name)
            page.evaluate(f"{CAPTURE}.finish()")
            answer(page, i, share=0.1, stage="fitting", notes=["1 event of the pen came late"])
            if name == "second":  # those of the first, of which the dialog was closed, come amid the second
                answer(page, 0, playable={"file": "first"})
                answer(page, 0, share=0.9)
                answer(page, 0, done={"file": "first"})
                shown = page.evaluate(f"[{is_open}, {CAPTURE}.step, document.querySelector('#learning').value]")
                assert shown == [True, "training", 0.1]
                assert page.evaluate("window.said.splice(0)") == [["first", False], ["first", True]]
            assert "1 event of the pen came late" in page.inner_text("#notes")
            if name == "first":
                page.click("#guide .close")
            else:
                answer(page, i, playable={"file": name})
            until(page, f"!{is_open} && {CAPTURE}.stream === null")
        assert page.evaluate("window.said.splice(0)") == [["second", False], ["third", False]]
        assert page.evaluate("window.sockets.map((one) => one.closed)") == [True, False, False]
        assert page.evaluate("window.sockets.map((one) => one.texts.map((text) => text.name ?? text.do))") == [
            [name, "train"] for name in ("first", "second", "third")
        ]
        answer(page, 1, refused="out of memory")
        assert page.evaluate("window.said.splice(0)") == ["second gets no better: out of memory"]
        begun(page, "fourth")
        answer(page, 2, refused="out of memory")  # the dialog is in front: what is said waits for its end
        assert page.evaluate(f"[{CAPTURE}.step, window.said.length]") == ["tap-in", 0]
        page.evaluate(f"{CAPTURE}.finish()")
        page.click("#guide .close")
        until(page, "window.said.length > 0")
        assert page.evaluate("window.said.splice(0)") == ["third gets no better: out of memory"]
        page.evaluate("window.sockets[3].onclose({ reason: '' })")
        assert page.evaluate("window.said.splice(0)") == ["fourth was not captured: the server is gone"]
        assert all(page.evaluate("window.sockets.map((one) => one.closed)"))
        begun(page, "fifth")
        answer(page, 4, refused="more than 12000 messages a second")
        assert page.evaluate(f"[{CAPTURE}.step, window.sockets[4].closed]") == ["failed", True]
        until(page, "document.querySelector('#trouble').textContent.startsWith('More than 12000')")
        assert page.is_visible("#keep")
        page.click("#go")
        begun(page, "sixth")
        page.click("#guide .close")  # amid the recording: that ends it
        until(page, "window.sockets[5].closed")


def test_what_is_saved_of_a_capture_can_be_imported(quiet_browser: Any, studio_link: str, tmp_path: Path) -> None:
    with opened_capture(quiet_browser, studio_link) as page:
        page.evaluate(SOCKETS)
        begun(page, "Denim")
        rows = np.column_stack([np.arange(40), np.zeros(40), np.full(40, 0.5), 0.005 * np.arange(40)])
        rows[10, 3] = rows[9, 3]  # of one time
        rows[20, 3] = rows[18, 3]  # late
        rows[30, 2:] = 0.0, rows[28, 3]  # late, and lifts
        page.evaluate(f"(rows) => ({CAPTURE}.current.events = rows)", rows.tolist())
        answer(page, 0, refused="the disk is full")
        files: list[Any] = []
        page.on("download", lambda file: files.append(file))
        page.click("#keep")
        end = time.monotonic() + 15
        while len(files) < 2 and time.monotonic() < end:
            page.wait_for_timeout(20)
        for file in files:
            file.save_as(tmp_path / file.suggested_filename)
        rate, samples = scipy.io.wavfile.read(tmp_path / "sound.wav")
        assert rate == page.evaluate(f"{CAPTURE}.current.about.rate_hz")
        assert samples.size == page.evaluate(f"{CAPTURE}.current.nSamples") > 0
        stroke = read_stroke(tmp_path / "pen.csv", {})
        expected, n_late = in_order(rows)
        np.testing.assert_allclose(stroke["position_x"], expected[:, 0])
        np.testing.assert_allclose(stroke["time"], expected[:, 3])
        assert n_late == 2
        until(page, "document.querySelector('#trouble').textContent.startsWith('2 events of the pen came late')")


def test_each_input_has_its_own_full_scale(quiet_browser: Any, studio_link: str) -> None:
    with opened_capture(quiet_browser, studio_link) as page:
        page.evaluate(SOCKETS)
        page.click("#capture-one")
        until(page, f"Boolean({CAPTURE}.levels)")
        page.click("#set-up summary")
        page.fill("#sensor", "2")
        page.fill("#full", "100")
        known = "full scale is 50.0 m/s²"
        assert known in page.inner_text("#set-up summary")
        first, second = page.evaluate("[...document.querySelectorAll('#inputs option')].map((one) => one.value)")[:2]

        def choose(device: str) -> None:
            page.select_option("#inputs", device)
            until(page, f"Boolean({CAPTURE}.levels) && document.querySelector('#inputs').value === '{device}'")

        choose(second)
        assert page.evaluate(f"{CAPTURE}.fullScale") is None
        assert "relative units" in page.inner_text("#set-up summary")
        assert page.input_value("#sensor") == page.input_value("#full") == ""
        page.click("#calibrator")  # the test tone of the browser is as good as one
        until(page, f"{CAPTURE}.fullScale > 0")
        by_calibrator = page.evaluate(f"{CAPTURE}.fullScale")
        choose(first)
        assert page.evaluate(f"{CAPTURE}.fullScale") == 50
        assert [page.input_value(one) for one in ("#sensor", "#full")] == ["2", "100"]
        page.reload()
        page.wait_for_selector("html[data-ready]")
        page.evaluate(SOCKETS)
        begun(page, "Denim")
        assert page.evaluate("window.sockets[0].texts[0].full_scale_m_s2") == 50
        page.evaluate(f"{CAPTURE}.fail('enough')")
        page.click("#go")
        until(page, f"Boolean({CAPTURE}.levels)")
        page.click("#set-up summary")
        shot(page, "capture-sensitivity")
        page.click("#relative")
        choose(second)
        assert page.evaluate(f"{CAPTURE}.fullScale") == by_calibrator
        choose(first)
        assert page.evaluate(f"{CAPTURE}.fullScale") is None


def test_an_input_that_comes_after_the_dialog_was_closed_is_let_go(quiet_browser: Any, studio_link: str) -> None:
    with opened_capture(quiet_browser, studio_link) as page:
        page.evaluate(
            """() => {
              const get = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
              navigator.mediaDevices.getUserMedia = async (asked) => {
                const stream = await get(asked);
                await new Promise((resolve) => (window.give = resolve));
                return (window.given = stream);
              };
            }"""
        )
        page.click("#capture-one")
        until(page, "Boolean(window.give)")
        page.click("#guide .close")
        until(page, "!document.querySelector('#capture').open")
        page.wait_for_timeout(50)
        page.evaluate("window.give()")
        until(page, "window.given?.getAudioTracks()[0].readyState === 'ended'")
        assert page.evaluate(f"[{CAPTURE}.stream, {CAPTURE}.step]") == [None, "set-up"]


@pytest.mark.slow
def test_a_surface_is_captured(
    browser: Any, studio_link: str, captures: Path, performance: SimulatedCapture, tmp_path: Path
) -> None:
    with opened_capture(browser, studio_link) as page:
        perform(page, performance)
        until(page, f"{CAPTURE}.step === 'stroke'", 30.0)
        page.wait_for_timeout(12_000)
        shot(page, "capture-strokes")
        until(page, "window.strokesEnded", 60.0)
        stroked = time.monotonic()
        page.click("#go")
        until(page, f"{CAPTURE}.step === 'training'", 30.0)
        if page.evaluate("window.lostSound") or page.evaluate("window.latest") > BUSY_MS:
            pytest.skip("the machine is too busy: the browser lost sound, or the hand stood still")
        until(page, "!document.querySelector('#capture').open", 120.0)
        until(page, "document.querySelector('#now-name').textContent === 'Test mesh'", 10.0)
        print(f"playable {time.monotonic() - stroked:.1f} s after the last stroke")
        until(page, "document.querySelector('#message').textContent.includes('is learned')", 300.0)
        shot(page, "capture-learned")
    (folder,) = captures.iterdir()
    recording = load_recording(folder / "test-mesh.h5")
    rate, sound = scipy.io.wavfile.read(folder / "sound.wav")
    lag = lag_s(recording, sound, rate, performance)
    other = simulate_capture("steel-mesh-1", 30.0, seed=1).recording
    captured = judged(folder / "test-mesh.foten", other)
    train_recording(performance.recording, inspect_recording(performance.recording).carried, tmp_path / "true.foten")
    true = judged(tmp_path / "true.foten", other)
    print(f"pen {1000 * lag:+.1f} ms; log-spectral distance {captured:.2f} dB, from the true recording {true:.2f} dB")
    assert abs(lag) <= 0.003
    assert captured <= 1.1 * true
