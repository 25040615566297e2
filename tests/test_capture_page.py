"""A surface captured in a browser: its fake microphone hears a simulated surface, synthetic events stroke it, a texture comes of it.

The pen's clock runs 50 ppm fast and 80 ms late.
"""

from __future__ import annotations

import json
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
from foten.dsp import Array
from pen_on_surface import BEGIN_S, CALIBRATION, CUE_S, FULL_SCALE, SOUND_HZ, Performance, performed
from test_studio import started
from test_studio_page import CHROMIUM, SHOTS, playwright, until

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt install chromium")]
DELAY_S, DRIFT = 0.08, 50e-6  # of the pen's clock
EVENTS_HZ = 200.0
CAPTURE = "window.studio.capture"

# Dispatches the plan by the page's own clock, ±20 % of a step early or late, from when the sound began.
PERFORM = """({ plan, began, delay, drift, hz }) => {
  const canvas = document.querySelector("#surface"), box = canvas.getBoundingClientRect(), mm = window.studio.capture.pad.mmPerPx;
  canvas.setPointerCapture = () => {};
  let was = 0, i = 0;
  const say = (type, x, y, pressure) => canvas.dispatchEvent(new PointerEvent(type, { pointerId: 7, pointerType: "pen", pressure,
    clientX: box.left + 20 + x / mm, clientY: box.top + 20 + y / mm, bubbles: true, button: 0, buttons: 1 }));
  window.performing = true;
  const step = () => {
    const at = (performance.now() - began - 1000 * delay) / 1000 * (1 + drift);
    while (i + 1 < plan.length && plan[i + 1][0] <= at) i++;
    const [, x, y, pressure] = plan[i];
    if (pressure > 0 && was === 0) say("pointerdown", x, y, pressure);
    else if (pressure > 0) say("pointerrawupdate", x, y, pressure);
    else if (was > 0) say("pointerup", x, y, 0);
    was = pressure;
    if (i + 1 < plan.length) setTimeout(step, 1000 / hz * (0.8 + 0.4 * Math.random()));
    else window.performing = false;
  };
  step();
}"""


def opened_capture(browser: Any, link: str, size: tuple[int, int] = (1280, 800)) -> Any:
    context = browser.new_context(viewport={"width": size[0], "height": size[1]}, permissions=["microphone"])
    page = context.new_page()
    page.goto(link)
    page.wait_for_selector("html[data-ready]")
    return page


def perform(page: Any, performance: Performance) -> None:
    """Play the part of the hand; the sound runs since the page began to listen."""
    page.click("#capture-one")
    page.fill("#called", "Test mesh")
    page.click("#set-up summary")
    page.fill("#sensor", "1")
    page.fill("#full", str(FULL_SCALE))
    heard = f"{CAPTURE}.peaks?.find(([, peak]) => peak > 0.1)"
    until(page, f"Boolean({heard})", 2 * BEGIN_S)
    began = 1000 * (page.evaluate(f"{heard}[0]") - BEGIN_S + CUE_S)
    page.click("#go")
    plan = performance.plan[::2].round(4).tolist()
    page.evaluate(PERFORM, {"plan": plan, "began": began, "delay": DELAY_S, "drift": DRIFT, "hz": EVENTS_HZ})


def main() -> None:
    """A trial."""


if __name__ == "__main__":
    import sys
    key, seconds, folder = sys.argv[1], float(sys.argv[2]), Path(sys.argv[3])
    folder.mkdir(parents=True, exist_ok=True)
    performance = performed(key, seconds)
    print("sound peak", np.abs(performance.sound).max())
    performance.write_sound(folder / "fake.wav")
    process, link = started("--captures", str(folder / "captures"))
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--use-fake-device-for-media-stream",
            "--use-fake-ui-for-media-stream", f"--use-file-for-fake-audio-capture={folder / 'fake.wav'}%noloop"])
        page = opened_capture(browser, link)
        page.on("console", lambda m: print("console", m.text))
        page.on("pageerror", lambda m: print("error", m))
        t0 = time.time()
        perform(page, performance)
        shots = 0
        said = ""
        state = ""
        while time.time() - t0 < seconds + 150:
            now = page.evaluate(f"[{CAPTURE}.step, document.querySelector('#trouble').textContent, document.querySelector('#step').textContent, {CAPTURE}.knocks, document.querySelector('#message').textContent, document.querySelector('#capture').open]")
            if str(now) != said:
                print(f"{time.time()-t0:6.1f}", now, flush=True)
                said = str(now)
            if (now[0] != state and "tap" not in now[0]) or (now[0] == "stroke" and shots == 0 and time.time() - t0 > 15):
                page.screenshot(path=str(folder / f"{shots}-{now[0]}.png"))
                shots += 1
                state = now[0]
            if now[0] == "stroke" and not page.evaluate("window.performing"):
                break
            if "is learned" in now[4] or now[0] == "failed":
                break
            # the hand ends its strokes when its plan says so
            if now[0] == "stroke" and (page.evaluate("performance.now()") > page.evaluate(f"1000*{CAPTURE}.peaks.at(-1)[0]") + 0 ) and time.time() - t0 > performance.strokes_s[1] + 0.5:
                page.click("#go")
            page.wait_for_timeout(100)
        page.screenshot(path=str(folder / "end.png"))
        browser.close()
    process.send_signal(signal.SIGTERM)
    print(process.communicate(timeout=30)[1][-500:])
