"""A surface captured in a browser: its microphone hears a simulated surface, synthetic events stroke it, a texture comes of it.

The pen's clock runs 50 ppm fast and 80 ms late.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io.wavfile
import scipy.signal

from foten.datasets.hdf5 import load_recording
from foten.datasets.simulated_capture import BEGIN_S, CUE_S, FULL_SCALE, SOUND_HZ, SimulatedCapture, simulate_capture
from foten.dsp import Array
from foten.evaluate.evaluate import evaluate
from foten.families.texture_file import read_texture
from foten.recording.inspection import inspect_recording
from foten.recording.recording import Recording
from foten.train.captured import train_recording
from test_studio import started
from test_studio_page import CHROMIUM, SHOTS, SIZES, playwright, until

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt install chromium")]
DELAY_S, DRIFT = 0.08, 50e-6  # of the pen's clock
EVENTS_HZ = 200.0
CAPTURE = "window.studio.capture"

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


def opened_capture(browser: Any, link: str, size: tuple[int, int] = (1280, 800), dark: bool = False) -> Any:
    viewport, scheme = {"width": size[0], "height": size[1]}, "dark" if dark else "light"
    context = browser.new_context(viewport=viewport, color_scheme=scheme, permissions=["microphone"])
    page = context.new_page()
    page.goto(link)
    page.wait_for_selector("html[data-ready]")
    return page


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
    plan = performance.plan[::2].round(4).tolist()
    end = performance.strokes_s[1]
    page.evaluate(
        PERFORM, {"plan": plan, "end": end, "began": began, "delay": DELAY_S, "drift": DRIFT, "hz": EVENTS_HZ}
    )


def shot(page: Any, name: str) -> None:
    SHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SHOTS / f"{name}.png")


@pytest.fixture
def performance() -> SimulatedCapture:
    return simulate_capture("steel-mesh-1", 30.0)


@pytest.fixture
def studio_link(tmp_path: Path) -> Iterator[str]:
    process, link = started("--captures", str(tmp_path / "captures"))
    yield link
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30)


@pytest.fixture
def browser(tmp_path: Path, performance: SimulatedCapture) -> Iterator[Any]:
    """A browser whose microphone hears the performance."""
    performance.write(tmp_path / "performance", np.random.default_rng(0))
    microphone = f"--use-file-for-fake-audio-capture={tmp_path / 'performance' / 'sound.wav'}%noloop"
    flags = ["--no-sandbox", "--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream", microphone]
    with playwright.sync_playwright() as started_playwright:
        browser = started_playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield browser
        browser.close()


def lag_s(recording: Recording, sound: Array, rate_hz: int, performance: SimulatedCapture) -> float:
    """Return how much later than in truth the pen is in a recording; where its sound begins in the true one is seen in both."""
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
    missed = [
        np.abs(speed[inside] - np.interp(x.times[inside] + begins - lag, plan[:, 0], true)).mean() for lag in lags
    ]
    return float(lags[int(np.argmin(missed))])


def judged(path: Path, recording: Recording) -> float:
    """Return the log-spectral distance [dB] of a texture's free run over a recording that it was not trained on."""
    document = evaluate(read_texture(path), recording).document
    distance: float = document["free_run"]["lsd_db"]
    return distance


@pytest.fixture(scope="module")
def quiet_browser() -> Iterator[Any]:
    """A browser whose microphone beeps once a second."""
    with playwright.sync_playwright() as started_playwright:
        flags = ["--no-sandbox", "--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream"]
        browser = started_playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield browser
        browser.close()


@pytest.mark.parametrize(("size", "dark"), [*((size, False) for size in SIZES), ("desktop", True), ("phone", True)])
def test_it_can_be_read_and_used_by_all(quiet_browser: Any, studio_link: str, size: str, dark: bool) -> None:
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="needs axe-core: pip install '.[browser]'"
    )
    page = opened_capture(quiet_browser, studio_link, SIZES[size], dark)
    page.click("#capture-one")
    until(page, "document.querySelectorAll('#inputs option').length > 0")
    for step in ("set-up", "tap-in", "stroke", "training", "failed"):
        page.evaluate(f"(step) => {{ {CAPTURE}.enter(step); {CAPTURE}.draw(); }}", step)
        shot(page, f"capture-{size}-{'dark' if dark else 'light'}-{step}")
        assert axe.Axe().run(page).response["violations"] == []
    page.context.close()


def test_an_input_that_the_browser_filters_is_refused(quiet_browser: Any, studio_link: str) -> None:
    page = opened_capture(quiet_browser, studio_link)
    page.evaluate(
        """() => {
          const given = MediaStreamTrack.prototype.getSettings;
          MediaStreamTrack.prototype.getSettings = function () { return { ...given.call(this), noiseSuppression: true }; };
        }"""
    )
    page.click("#capture-one")
    until(page, f"{CAPTURE}.step === 'failed'")
    until(page, "document.querySelector('#trouble').textContent.includes('does not turn off noise suppression')")
    page.context.close()


def test_filters_are_asked_to_be_off(quiet_browser: Any, studio_link: str) -> None:
    page = opened_capture(quiet_browser, studio_link)
    page.click("#capture-one")
    until(page, f"Boolean({CAPTURE}.stream)")
    settings = page.evaluate(f"{CAPTURE}.stream.getAudioTracks()[0].getSettings()")
    assert [settings[name] for name in ("echoCancellation", "noiseSuppression", "autoGainControl")] == [False] * 3
    page.click("#guide .close")
    until(page, f"{CAPTURE}.stream === null")
    page.context.close()


LEVELS = """async ({ pause, stroke }) => {
  const { Levels } = await import("/levels.js"), levels = new Levels(48000);
  const part = (samples, down) => {
    for (let i = 0; i + 896 <= samples.length; i += 896) levels.add(Float32Array.from(samples.slice(i, i + 896)), down);
  };
  part(pause, false);
  part(stroke, true);
  return levels.trouble;
}"""


@pytest.mark.parametrize(
    ("pause", "stroke", "said"),
    [
        ("quiet", "loud", None),
        ("quiet", "clipped", "It clips"),
        ("silent", "silent", "The input is silent"),
        ("quiet", "faint", "hardly louder than the room"),
        ("quiet", "lost", "Parts of the sound are missing"),
        ("hum", "loud", "It hums at 50 Hz"),
    ],
)
def test_what_is_wrong_with_an_input_is_said(
    quiet_browser: Any, studio_link: str, pause: str, stroke: str, said: str | None
) -> None:
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
    page = opened_capture(quiet_browser, studio_link)
    trouble = page.evaluate(LEVELS, {"pause": sounds[pause].tolist(), "stroke": sounds[stroke].tolist()})
    assert (trouble is None) if said is None else said in trouble
    page.context.close()


@pytest.mark.slow
def test_a_surface_is_captured(browser: Any, studio_link: str, performance: SimulatedCapture, tmp_path: Path) -> None:
    page = opened_capture(browser, studio_link)
    perform(page, performance)
    until(page, f"{CAPTURE}.step === 'stroke'", 30.0)
    page.wait_for_timeout(12_000)
    shot(page, "capture-strokes")
    until(page, "window.strokesEnded", 60.0)
    page.click("#go")
    until(page, f"{CAPTURE}.step === 'training'", 30.0)
    if page.evaluate("window.lostSound") or page.evaluate("window.latest > 200"):
        pytest.skip("the machine is too busy: the browser lost sound, or the hand stood still")
    ended = time.monotonic()
    until(page, "!document.querySelector('#capture').open", 120.0)
    until(page, "document.querySelector('#now-name').textContent === 'Test mesh'", 10.0)
    playable_s = time.monotonic() - ended
    until(page, "document.querySelector('#message').textContent.includes('is learned')", 300.0)
    shot(page, "capture-learned")
    (folder,) = (tmp_path / "captures").iterdir()
    recording = load_recording(folder / "test-mesh.h5")
    rate, sound = scipy.io.wavfile.read(folder / "sound.wav")
    lag = lag_s(recording, sound, rate, performance)
    other = simulate_capture("steel-mesh-1", 30.0, seed=1).recording
    captured = judged(folder / "test-mesh.foten", other)
    train_recording(performance.recording, inspect_recording(performance.recording).carried, tmp_path / "true.foten")
    true = judged(tmp_path / "true.foten", other)
    print(
        f"\nplayable {playable_s:.1f} s after the last tap; pen {1000 * lag:+.1f} ms; "
        f"log-spectral distance {captured:.2f} dB, from the true recording {true:.2f} dB"
    )
    assert abs(lag) <= 0.003
    assert captured <= 1.1 * true
