"""The page in a browser: a tap, a pen with pressure, and what is heard is what the kernel renders.

Screenshots of it, at three sizes, go to build/screenshots.
"""

from __future__ import annotations

import base64
import contextlib
import csv
import functools
import http.server
import itertools
import re
import shutil
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io.wavfile
from PIL import Image

from conftest import exported
from foten.cli.command_line import _status
from foten.datasets.importing import read_stroke
from foten.dsp import Array
from foten.models.texture_file import read_texture, write_texture
from foten.models.trainable import TRAINABLE
from foten.runtime.actuator import ActuatorProfile, write_profile
from foten.runtime.renderer import EXAMPLE, Renderer
from foten.runtime.stroke import tabled_stroke
from foten.runtime.stylus import Stylus
from foten.studio.levels import gains_db
from test_kernel_build import WASM
from test_studio_server import serving
from test_wheels import script

playwright = pytest.importorskip("playwright.sync_api", reason="needs Playwright: pip install '.[browser]'")
CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)
pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt install chromium")]
DOCS = Path(__file__).parents[1] / "docs"
SHOTS = Path(__file__).parents[1] / "build" / "screenshots"
SIZES = {"phone": (390, 844), "tablet": (820, 1180), "desktop": (1280, 800), "landscape": (1024, 768)}
QUANTUM = 128  # samples that an AudioWorklet renders at once


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two methods of a mesh, of which one is grass by its sound and not as loud, and a towel by name."""
    folder = tmp_path_factory.mktemp("shelf")
    mesh, grass = read_texture(EXAMPLE), read_texture(EXAMPLE.with_name("artificial-grass.foten"))
    for name, texture, called in (("mesh", mesh, mesh), ("mesh2", grass, mesh), ("towel", mesh, None)):
        card = {**texture.card, "texture": called.card["texture"] if called else "towel"}
        write_texture(type(texture)(card, texture.tensors), folder / f"{name}.foten")
    return folder


@pytest.fixture(scope="module")
def link(shelf: Path) -> Iterator[str]:
    with serving(str(shelf)) as (_, link):
        yield link


@contextlib.contextmanager
def chromium(*flags: str) -> Iterator[Any]:
    with playwright.sync_playwright() as started_playwright:
        browser = started_playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *flags])
        yield browser
        browser.close()


def look(page: Any, name: str, sizes: Sequence[str] = ("phone", "tablet", "desktop"), part: str = "html") -> list[Any]:
    """Take screenshots of a page for people, light and dark, and return what axe-core complains of in a part of it."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs pip install '.[browser]'")
    SHOTS.mkdir(parents=True, exist_ok=True)
    complaints = []
    page.evaluate(axe.Axe().axe_script)
    for size, scheme in itertools.product(sizes, ("light", "dark")):
        width, height = SIZES[size]
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
        page.evaluate("new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        page.screenshot(path=SHOTS / f"{name}-{size}-{scheme}.png")
        violations = page.evaluate("(part) => axe.run(part, { resultTypes: ['violations'] })", part)["violations"]
        complaints += [(name, size, scheme, v["id"], [node["html"] for node in v["nodes"]]) for v in violations]
    return complaints


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium("--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream") as browser:
        yield browser


@contextlib.contextmanager
def opened(browser: Any, link: str, tap: bool = True) -> Iterator[Any]:
    """Open the page, and end with nothing that the browser complained of."""
    context = browser.new_context()
    page = context.new_page()
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: message.type == "error" and complaints.append(message.text))
    page.goto(link)
    page.wait_for_selector("html[data-ready]")
    until(page, "document.querySelectorAll('#textures .swatch').length > 0")
    if tap:
        page.click("#begin")
        until(page, f"{STATE}.sound.running && {STATE}.sound.infos.size > 0")
        page.evaluate(f"{STATE}.pad.ghost = null")
    yield page
    assert not complaints
    context.close()


STATE = "window.studio"


def until(page: Any, expression: str, seconds: float = 15.0) -> None:
    """Wait until an expression holds; Playwright's own way is to evaluate text in the page, which that forbids."""
    end = time.monotonic() + seconds
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"after {seconds:g} s not yet: {expression}"
        page.wait_for_timeout(20)


class Pen:
    """A stylus with pressure and tilt, through the browser's own input."""

    def __init__(self, page: Any) -> None:
        self._devtools = page.context.new_cdp_session(page)
        box = page.locator("#pad").bounding_box()
        self._left, self._top = box["x"], box["y"]

    def send(self, kind: str, x: float, y: float, pressure: float) -> None:
        button = {"button": "left", "buttons": int(kind != "mouseReleased"), "clickCount": int(kind != "mouseMoved")}
        pen = {"pointerType": "pen", "x": self._left + x, "y": self._top + y, "force": pressure, "tiltX": 20}
        self._devtools.send("Input.dispatchMouseEvent", {"type": kind, **button, **pen})

    def stroke(self, page: Any, n: int = 60) -> None:
        """Draw a wave of n events, firmer and firmer, and lift."""
        x = np.linspace(60.0, 320.0, n)
        y = 120.0 + 40.0 * np.sin(np.arange(n) / 6)
        pressure = np.linspace(0.3, 0.7, n)
        self.send("mousePressed", x[0], y[0], pressure[0])
        for i in range(1, n):
            self.send("mouseMoved", x[i], y[i], pressure[i])
            page.wait_for_timeout(6)
        self.send("mouseReleased", x[-1], y[-1], 0.0)


def recorded(page: Any, stroke: Any) -> dict[str, Any]:
    """What the page recorded of a stroke: samples, events, rate, and the texture's id."""
    page.evaluate(
        f"""() => {{
          window.taken = null;
          {STATE}.sound.addEventListener("recorded", (e) => {{ window.taken = e.detail; }}, {{ once: true }});
        }}"""
    )
    page.click("#record")
    stroke()
    page.wait_for_timeout(200)
    page.click("#record")
    until(page, "window.taken !== null")
    result: dict[str, Any] = page.evaluate(
        """() => ({ events: taken.events, rate: taken.rate, seed: taken.seed,
          samples: btoa(Array.from(new Uint8Array(taken.samples.buffer), (byte) => String.fromCharCode(byte)).join("")) })"""
    )
    result["samples"] = np.frombuffer(base64.b64decode(result["samples"]), dtype="<f4")
    return result


def rendered(path: Path, taken: dict[str, Any]) -> Array:
    """What the kernel of this machine renders of the same events, given at the same samples."""
    renderer = Renderer(path, rate=taken["rate"], seed=taken["seed"])
    stylus, events = Stylus(renderer), taken["events"]
    out, at = [], 0
    for block in range(0, len(taken["samples"]), QUANTUM):
        while at < len(events) and events[at][0] <= block:
            stylus.push(*events[at][1:])
            at += 1
        out.append(stylus.render(QUANTUM))
    return np.concatenate(out)


def test_what_the_page_renders_is_what_the_kernel_renders_and_can_be_saved(
    browser: Any, link: str, shelf: Path, tmp_path: Path
) -> None:
    """A pen with pressure and tilt; the samples of the AudioWorklet beside those of this machine's instruction set."""
    with opened(browser, link) as page:
        taken = recorded(page, lambda: Pen(page).stroke(page))
        pressures = [event[3] for event in taken["events"]]
        assert min(pressures) == 0.0  # lifted
        assert 0.6 < max(pressures) <= 0.71
        assert len(taken["events"]) > 30
        in_page = taken["samples"]
        assert np.abs(in_page).max() > 0.2
        sd = Renderer(EXAMPLE).native_texture.info.acceleration_sd
        np.testing.assert_allclose(in_page / sd, rendered(shelf / "mesh.foten", taken) / sd, atol=1e-4)
        for what in ("csv", "wav"):
            with page.expect_download() as download:
                page.click(f"[data-do={what}]")
            download.value.save_as(tmp_path / f"stroke.{what}")
        with (tmp_path / "stroke.csv").open(newline="") as file:
            rows = list(csv.reader(file))
        assert rows[0] == ["t", "x", "y", "pressure"]
        assert len(rows) == 1 + len(taken["events"])
        # Both count from the moment at which recording began: the first event came after so many samples.
        assert float(rows[1][0]) == pytest.approx(taken["events"][0][0] / taken["rate"], abs=2e-6)
        assert float(rows[1][0]) > 0
        stroke = tabled_stroke(read_stroke(tmp_path / "stroke.csv", {}), 1000.0)
        assert 0.3 < stroke.force.max() < 1.6
        rate, samples = scipy.io.wavfile.read(tmp_path / "stroke.wav")
        assert rate == taken["rate"]
        peak = np.abs(in_page).max()
        np.testing.assert_allclose(samples, in_page / peak, atol=1e-6)  # nothing that plays it cuts it
        full_scale = re.search(rb"full scale is ([0-9.]+) m/s", (tmp_path / "stroke.wav").read_bytes()[:300])
        assert full_scale is not None
        assert float(full_scale[1]) == pytest.approx(peak, rel=1e-3)
        page.select_option("#taken select", label="Towel")
        page.click("[data-do=replay]")
        until(page, "document.querySelector('#now-name').textContent === 'Towel'")
        until(page, "Number(document.querySelector('#speed').value) > 5")


def test_what_a_pen_does_at_the_edge_and_at_its_lightest(browser: Any, link: str) -> None:
    """As in Sec. V-b: vibration only while the pen is down inside of the texture's area. A touch without pressure is light."""
    with opened(browser, link) as page:
        pen = Pen(page)

        def over_the_edge() -> None:
            pen.send("mousePressed", 30, 60, 0.5)
            for x in range(24, -60, -4):
                pen.send("mouseMoved", x, 60, 0.5)
            page.wait_for_timeout(300)
            for x in range(-60, -120, -4):
                pen.send("mouseMoved", x, 60, 0.5)
            pen.send("mouseReleased", -120, 60, 0)

        taken = recorded(page, over_the_edge)
        inside = [event for event in taken["events"] if event[3] > 0]
        assert inside
        assert all(event[1] >= 0 for event in inside)
        assert np.abs(taken["samples"][-2400:]).max() < 1e-3 * np.abs(taken["samples"]).max()

        page.keyboard.press("Escape")

        def touch() -> None:
            pen.send("mousePressed", 60, 60, 0.1)
            for x, pressure in ((62, 0.05), (64, 0.0), (66, 0.0)):
                pen.send("mouseMoved", x, 60, pressure)
                page.wait_for_timeout(10)
            pen.send("mouseReleased", 66, 60, 0.0)

        pressures = [event[3] for event in recorded(page, touch)["events"]]
        assert max(pressures) < 0.11
        assert pressures[-1] == 0.0
        assert min(pressures[:-1]) > 0.0
        page.keyboard.press("Escape")
        page.focus("#pad")  # the keys stroke too
        page.keyboard.down("ArrowRight")
        until(page, "Number(document.querySelector('#speed').value) > 30")
        page.keyboard.up("ArrowRight")
        until(page, "Number(document.querySelector('#speed').value) < 2")


def test_methods_are_compared_blind_and_equally_loud(browser: Any, link: str, shelf: Path) -> None:
    with opened(browser, link) as page:
        page.evaluate(
            f"""() => {{
              const {{ pad }} = {STATE}, setTile = pad.setTile.bind(pad);
              window.tiles = [];
              pad.setTile = (tile, mm) => {{ tiles.push(tile); setTile(tile, mm); }};
            }}"""
        )
        page.click("#compare")
        until(page, "document.querySelectorAll('#blind [role=radio]').length === 2")
        radios = page.locator("#blind [role=radio]")
        assert radios.all_inner_texts() == ["A", "B"]
        assert page.inner_text("#now-name") == "Compare blind"  # no name of a method anywhere
        assert "foten" not in page.inner_text("#stage")
        until(page, "document.querySelectorAll('#blind [role=radio]')[0].ariaChecked === 'true'")
        for n, i in ((2, 1), (3, 0)):
            until(page, f"window.tiles.length === {n - 1}")
            radios.nth(i).click()
            until(page, f"document.querySelectorAll('#blind [role=radio]')[{i}].ariaChecked === 'true'")
            until(page, f"window.tiles.length === {n}")
            assert page.evaluate("new Set(window.tiles).size") == 1  # nor a picture or a range that differs
            assert page.inner_text("#now-range") == ""
        gains = page.evaluate(f"Object.fromEntries({STATE}.sound.gains)")
        renderers = {name: Renderer(shelf / name) for name in ("mesh.foten", "mesh2.foten")}
        scales = [1 / one.native_texture.info.acceleration_sd for one in renderers.values()]
        expected = dict(zip(renderers, gains_db(list(renderers.values()), scales), strict=True))
        # dB, six times what they may differ by: else this would say nothing.
        assert np.ptp(list(expected.values())) > 0.3
        assert gains == pytest.approx(expected, abs=0.05)
        served = page.evaluate("fetch('gains?texture=mesh.foten&texture=mesh2.foten').then((answer) => answer.json())")
        assert served["gains_db"] == pytest.approx(list(expected.values()), abs=1e-9)
        radios.nth(1).click()
        until(page, "document.querySelector('#blind .choose').textContent === 'Choose B'")
        page.set_viewport_size({"width": 390, "height": 844})
        assert page.locator("#blind >> text=More like the surface?").is_visible()
        boxes = [page.locator(part).bounding_box() for part in ("#blind", "#press")]
        assert boxes[1]["y"] + boxes[1]["height"] <= boxes[0]["y"]  # which lay below the other on a phone

        page.click("#blind .choose")
        assert page.locator("#blind").is_hidden()
        message = page.inner_text("#message")
        assert re.match(r"A was mesh2?.foten, B was mesh2?.foten. Chosen so far: ", message)
        assert message.count("1×") == message.count("0×") == 1
        page.click("#compare")
        until(page, "document.querySelectorAll('#blind [role=radio]').length === 2")
        page.click("#textures .swatch >> text=Towel")  # another texture ends the comparison
        until(page, "document.querySelector('#now-name').textContent === 'Towel'")
        assert page.locator("#blind").is_hidden()
        assert page.evaluate(f"{STATE}.sound.gains.size") == 0


def dropped(page: Any, path: Path) -> None:
    """Drop a file on the page."""
    data = base64.b64encode(path.read_bytes()).decode()
    page.evaluate(
        """([name, data]) => {
          const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0)), transfer = new DataTransfer();
          transfer.items.add(new File([bytes], name));
          document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }));
        }""",
        [path.name, data],
    )


def at_the_server(page: Any) -> None:
    """Have the server render, and the page play it."""
    page.click("#settings")
    page.select_option("#path", "stream")
    until(page, f"{STATE}.sound.server !== null")
    page.keyboard.press("Escape")


def test_sliders_move_the_texture_under_the_hand_and_save_it(browser: Any, link: str, shelf: Path) -> None:
    """What is heard is louder by what the slider says, what is said is where it comes from, and what is saved is that."""
    with opened(browser, link) as page:
        page.click("#textures .swatch >> text=Towel")
        until(page, f"{STATE}.sound.id === 'towel.foten'")
        page.click("#tune-it")
        assert page.is_disabled("#tune-save")
        assert look(page, "tune") == []
        page.set_viewport_size({"width": 1280, "height": 720})
        page.evaluate(
            """() => {
              const one = document.querySelector("#tune-level");
              one.value = 6;
              one.dispatchEvent(new Event("input", { bubbles: true }));
            }"""
        )
        until(page, f"{STATE}.sound.id.startsWith('tuned-')")
        page.evaluate("document.querySelector('#tune-level').dispatchEvent(new Event('change', { bubbles: true }))")
        until(page, "!document.querySelector('#tune-save').disabled", 30)
        assert page.inner_text("#now-range").startswith("edited: level +6 dB, not measured")
        taken = recorded(page, lambda: Pen(page).stroke(page))
        page.keyboard.press("Escape")
        with page.expect_download() as download:
            page.click("#tune-save")
        assert download.value.suggested_filename == "towel-edited.foten"
        saved = Path(download.value.path())
        assert "edited: level +6 dB" in read_texture(saved).evidence
        files = {"plain": shelf / "towel.foten", "saved": saved}
        of = {name: rendered(path, {**taken, "seed": 0}) for name, path in files.items()} | {"page": taken["samples"]}
        level = {name: 10 * np.log10(np.mean(samples.astype(float) ** 2)) for name, samples in of.items()}
        assert level["saved"] - level["plain"] == pytest.approx(6, abs=0.3)
        assert abs(level["page"] - level["saved"]) < 3  # what is heard is what is saved
        page.click("#tune button[type=reset]")
        until(page, f"{STATE}.sound.id === 'towel.foten'")
        page.click("#tune-it")
        assert not page.is_visible("#tune")


def test_a_file_that_is_dropped_is_rendered_here_or_refused_in_a_line(browser: Any, link: str, tmp_path: Path) -> None:
    data, texture, path = EXAMPLE.read_bytes(), read_texture(EXAMPLE), tmp_path / "hostile.foten"
    with opened(browser, link) as page:
        for damaged in (data[:5000], b"<script>alert(1)</script>" * 400, data[:-4000] + bytes(4000)):
            path.write_bytes(damaged)
            dropped(page, path)
            until(page, "document.querySelector('#message').textContent.startsWith('hostile.foten was refused: ')")
            assert "\n" not in page.inner_text("#message")
            assert page.locator("#textures .swatch").count() == 2
            page.evaluate("document.querySelector('#message').textContent = ''")
        path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(500))
        dropped(page, path)
        until(page, "document.querySelector('#message').textContent.includes('it is HDF5, as a recording is')")
        at_the_server(page)
        path = tmp_path / "mine.foten"
        write_texture(type(texture)({**texture.card, "texture": "my denim"}, texture.tensors), path)
        dropped(page, path)
        until(page, "document.querySelector('#now-name').textContent === 'My denim'")
        until(page, f"{STATE}.sound.server === null")
        assert page.evaluate("document.querySelector('#path').value") == ""
        assert np.abs(recorded(page, lambda: Pen(page).stroke(page))["samples"]).max() > 0.2


def test_the_server_renders_where_it_is_asked_to_and_the_page_once_it_is_gone(browser: Any, shelf: Path) -> None:
    """What comes back is what this machine renders of these events, but for when they arrived."""
    with serving(str(shelf)) as (process, link), opened(browser, link) as page:
        at_the_server(page)
        apart = []  # dB, of three strokes: where a machine is busy, events of one may arrive in bunches
        for _ in range(3):
            taken = recorded(page, lambda: Pen(page).stroke(page))
            assert len(taken["events"]) > 30
            both = rendered(shelf / "mesh.foten", {**taken, "seed": 0}), taken["samples"]
            levels = [10 * np.log10(np.mean(samples.astype(float) ** 2)) for samples in both]
            apart.append(abs(levels[0] - levels[1]))
            page.keyboard.press("Escape")  # the dialog of what was recorded
        assert np.median(apart) < 3
        state = page.evaluate("fetch('/state').then((answer) => answer.json())")
        assert state["pages"][0]["n_events"] > 20
        assert state["pages"][0]["stylus"]["n_dropped"] == 0
        process.terminate()
        process.communicate(timeout=30)
        until(page, f"{STATE}.sound.server === null")
        assert "the server is gone" in page.inner_text("#message")
        assert np.abs(recorded(page, lambda: Pen(page).stroke(page))["samples"]).max() > 0.2


def test_the_force_is_calibrated_by_where_the_pen_was_held_still(browser: Any, link: str) -> None:
    """A pen that leaves the scale presses less and less, and that is not what the scale shows."""
    with opened(browser, link, tap=False) as page:
        page.click("#settings")
        box = page.locator("#weigh").bounding_box()
        pen = Pen(page)
        pen._left, pen._top = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        for held, grams in ((0.2, 25.0), (0.5, 70.0), (0.8, 190.0)):
            pen.send("mousePressed", 0, 0, 0.05)
            for k in range(18):
                pen.send("mouseMoved", k % 2, 0, held)
                page.wait_for_timeout(20)
            for share in (0.8, 0.5, 0.2, 0.05):
                pen.send("mouseMoved", 0, 0, share * held)
            pen.send("mouseReleased", 0, 0, 0)
            assert float(page.inner_text("#pressure")) == pytest.approx(held, abs=0.01)
            page.fill("#grams", str(grams))
            page.click("#add")
        assert "from 3 weighings" in page.inner_text("#curve")
        fitted = page.evaluate("JSON.parse(localStorage.getItem('calibration'))")
        assert fitted["steepness"] == pytest.approx(3.4, abs=0.3)
        page.click("#paper")


@pytest.mark.parametrize("size", SIZES)
def test_a_card_held_to_the_bar_gives_the_size_of_the_screen(browser: Any, link: str, size: str) -> None:
    """On phones and tablets the bar was cut off, while the size followed the slider."""
    with opened(browser, link, tap=False) as page:
        page.set_viewport_size(dict(zip(("width", "height"), SIZES[size], strict=True)))
        page.click("#settings")
        slider, card = page.locator("#size"), page.locator("#card")
        for end in ("min", "max"):
            slider.evaluate(f"(slider) => {{ slider.value = slider.{end}; slider.dispatchEvent(new Event('input')); }}")
            length, box = float(slider.input_value()), card.bounding_box()
            assert min(abs(box[side] - length) for side in ("width", "height")) < 0.5
            assert page.evaluate(f"{STATE}.pad.mmPerPx") * length == pytest.approx(53.98, rel=2e-3)
            assert length <= SIZES[size][1]


def test_another_output_and_one_of_its_channels_are_played_on(browser: Any, link: str) -> None:
    """A voice coil is on the second channel of a sound card that is not the usual one."""
    with opened(browser, link) as page:
        page.click("#settings")
        until(page, "document.querySelectorAll('#sink option').length > 1")
        if page.evaluate("[...document.querySelector('#sink').options].some((one) => one.value === 'others')"):
            page.select_option("#sink", "others")
            until(page, "document.querySelectorAll('#sink option').length > 2")
        name = page.evaluate("document.querySelector('#sink').options[1].label")
        page.select_option("#sink", label=name)
        until(page, f"{STATE}.sound.context.sinkId === document.querySelector('#sink').value")
        page.select_option("#channel", index=2)
        until(page, "localStorage.getItem('channel') === '1'")
        assert page.evaluate(f"{STATE}.sound.context.destination.channelInterpretation") == "discrete"
        page.keyboard.press("Escape")
        Pen(page).stroke(page)
        until(page, f"{STATE}.monitor.latest?.rms > 0")


def test_a_stroke_may_begin_on_the_button(browser: Any, link: str) -> None:
    """It was lost, with no sound, and the button stayed."""
    with opened(browser, link, tap=False) as page:
        box = page.locator("#begin").bounding_box()
        page.mouse.move(box["x"] + 60, box["y"] + 60)
        page.mouse.down()
        # Back and forth until sound has begun, which may take longer than a trail stays.
        running = f"{STATE}.sound.running && {STATE}.pad.trail.length > 5 && {STATE}.monitor.latest?.rms > 0"
        end = time.monotonic() + 15
        for i in itertools.count():
            page.mouse.move(box["x"] + 60 + 4 * (40 - abs(40 - i % 80)), box["y"] + 60)
            page.wait_for_timeout(10)
            if i > 40 and page.evaluate(running):
                break
            assert time.monotonic() < end, f"after 15 s not yet: {running}"
        page.mouse.up()
        assert page.locator("#begin").is_hidden()
        assert not page.evaluate(f"{STATE}.pad.ghost")  # it was no tap


def test_the_server_may_render_from_the_first_stroke_on(browser: Any, link: str) -> None:
    """\"events before a texture was opened\", until another texture was chosen."""
    with opened(browser, link, tap=False) as page:
        at_the_server(page)
        assert page.locator("#message").is_hidden()
        Pen(page).stroke(page)
        until(page, f"{STATE}.monitor.latest?.rms > 0")
        assert page.locator("#message").is_hidden()
        assert page.evaluate(f"{STATE}.sound.server.state") is not None


def test_a_press_on_the_surface_begins_it_and_a_recording_is_seen(browser: Any, link: str) -> None:
    with opened(browser, link, tap=False) as page:
        Pen(page).stroke(page)
        until(page, f"{STATE}.sound.running")
        assert page.locator("#begin").is_hidden()
        assert page.locator("#recorded").is_hidden()
        page.click("#record")
        until(page, "document.querySelector('#recorded').value === '0:01'")
        assert page.get_attribute("#record", "title") == "Stop recording"
        page.click("#record")
        assert page.locator("#recorded").is_hidden()


def test_a_refusal_does_not_stay_over_the_next_texture(browser: Any, link: str, tmp_path: Path) -> None:
    (tmp_path / "bad.foten").write_bytes(b"x" * 100)
    with opened(browser, link) as page:
        dropped(page, tmp_path / "bad.foten")
        until(page, "document.querySelector('#message').textContent.startsWith('bad.foten was refused')")
        page.click("#textures .swatch >> text=Towel")
        until(page, "document.querySelector('#now-name').textContent === 'Towel'")
        assert page.locator("#message").is_hidden()


def drag(page: Any, element: str) -> None:
    """A stroke of the mouse over an element, at 250 px a second."""
    box = page.locator(element).bounding_box()
    assert box["height"] > 100
    page.mouse.move(box["x"] + 20, box["y"] + 60)
    page.mouse.down()
    for i in range(120):
        page.mouse.move(box["x"] + 20 + 2 * i, box["y"] + 60)
        page.wait_for_timeout(8)
    page.mouse.up()


@contextlib.contextmanager
def hosted(folder: Path) -> Iterator[str]:
    """A folder as any host would serve it, on this machine."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@contextlib.contextmanager
def visited(browser: Any, folder: Path, **options: Any) -> Iterator[Any]:
    """The first page of a folder that is hosted."""
    with hosted(folder) as link:
        page = browser.new_page(**options)
        page.goto(link)
        yield page
        page.close()


def in_a_browser(folder: Path, number: int) -> None:
    """The page of the tutorial, with the package as npm has it and nothing else copied by hand."""
    script(WASM / "pack.py").write_package(folder / "foten")
    shutil.copy(EXAMPLE, folder / "mesh.foten")
    pages = re.findall(r"```html\n(.*?)```", (DOCS / "tutorials" / "browser.md").read_text(encoding="utf-8"), re.S)
    (folder / "index.html").write_text(pages[number], encoding="utf-8")


def test_ten_lines_put_a_texture_on_a_canvas_of_ones_own(browser: Any, tmp_path: Path) -> None:
    in_a_browser(tmp_path, 1)
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    lines = text.partition('<script type="module">')[2].partition("</script>")[0].strip().splitlines()
    assert len(lines) == 10
    (tmp_path / "index.html").write_text(text.replace("const node =", "const node = window.node ="), encoding="utf-8")
    with visited(browser, tmp_path) as page:
        until(page, "window.node !== undefined")
        page.evaluate(
            """() => {
              node.port.addEventListener("message", ({ data }) => {
                window.rms = Math.max(window.rms ?? 0, data.report?.rms ?? 0);
              });
              const analyser = new AnalyserNode(node.context, { fftSize: 2048 }), heard = new Float32Array(2048);
              node.connect(analyser);
              window.peak = 0;
              setInterval(() => {
                analyser.getFloatTimeDomainData(heard);
                window.peak = heard.reduce((most, value) => Math.max(most, Math.abs(value)), window.peak);
              }, 20);
            }"""
        )
        drag(page, "canvas")
        until(page, "window.rms > 0.1 && window.peak > 0.01")
        assert page.evaluate("window.peak") < 0.5  # it was full scale, in headphones


def test_two_lines_put_a_texture_on_a_page_of_ones_own(browser: Any, tmp_path: Path) -> None:
    """The package as npm has it, with nothing copied by hand; a bad file is refused in a line."""
    (tmp_path / "bad.foten").write_bytes(b"x" * 99)
    in_a_browser(tmp_path, 0)
    with visited(browser, tmp_path) as page:
        until(page, "document.querySelector('foten-pad').texture?.src === 'mesh.foten'")
        page.evaluate(
            """() => {
              window.told = {};
              const element = document.querySelector("foten-pad");
              for (const type of ["ready", "refused"]) element.addEventListener(type, ({ detail }) => { told[type] = detail; });
              element.sound.addEventListener("report", ({ detail }) => { told.rms = Math.max(told.rms ?? 0, detail.rms); });
            }"""
        )
        drag(page, "foten-pad")
        until(page, "told.ready && told.rms > 0.1")
        page.evaluate("document.querySelector('foten-pad').src = 'bad.foten'")
        until(page, "told.refused?.startsWith('this is not a texture file')")
        page.evaluate("document.querySelector('foten-pad').src = 'none.foten'")
        refused = "document.querySelector('foten-pad').dataset.refused"
        until(page, f"{refused}?.startsWith('none.foten could not be fetched')")
        page.evaluate("document.querySelector('foten-pad').src = 'mesh.foten'")
        until(page, f"!{refused}")


def test_the_element_has_a_size_follows_its_source_and_rests_where_it_was_taken_away(
    browser: Any, shelf: Path, tmp_path: Path
) -> None:
    in_a_browser(tmp_path, 0)
    shutil.copy(shelf / "mesh2.foten", tmp_path / "other.foten")
    with visited(browser, tmp_path, device_scale_factor=3) as page:
        until(page, "document.querySelector('foten-pad').texture?.src === 'mesh.foten'")
        # 16rem, which a rule of the page's own changes.
        assert page.locator("foten-pad").bounding_box()["height"] == 256
        page.add_style_tag(content="foten-pad { height: 9rem }")
        assert page.locator("foten-pad > canvas").bounding_box()["height"] == 144
        page.evaluate("window.element = document.querySelector('foten-pad')")
        page.evaluate("element.sound.route('', 1)")  # before it sounds
        drag(page, "foten-pad")
        until(page, "element.sound.id === 'mesh.foten'")
        assert page.evaluate("element.sound.context.destination.channelInterpretation") == "discrete"
        page.evaluate("for (const src of ['other.foten', 'mesh.foten', 'other.foten']) element.src = src")
        until(page, "element.sound.id === 'other.foten'")
        page.evaluate("element.remove()")
        until(page, "element.sound.context.state === 'suspended'")


def test_an_element_without_its_worker_says_so(browser: Any, tmp_path: Path) -> None:
    in_a_browser(tmp_path, 0)
    (tmp_path / "foten" / "surface.js").unlink()
    with hosted(tmp_path) as link:
        page = browser.new_page()
        page.add_init_script("addEventListener('refused', ({ detail }) => { window.refused = detail; }, true)")
        page.goto(link)
        until(page, "window.refused?.includes('surface.js has to be beside painter.js')")
        page.close()


SITE = Path(__file__).parents[1] / "build" / "site"


@pytest.mark.skipif(not (SITE / "live").exists(), reason="needs the built site: make docs")
def test_the_first_page_of_the_site_has_a_live_surface(browser: Any) -> None:
    with visited(browser, SITE) as page:
        until(page, "document.querySelector('foten-pad').texture?.src === 'live/textures/jeans.foten'")
        page.click("#live-gallery >> text=Towel")
        until(page, "document.querySelector('foten-pad').sound.id === 'live/textures/towel.foten'")
        page.evaluate(
            """() => document.querySelector("foten-pad").sound.addEventListener(
              "report", ({ detail }) => { window.rms = Math.max(window.rms ?? 0, detail.rms); })"""
        )
        drag(page, "foten-pad")
        until(page, "window.rms > 0.1")
        assert page.inner_text("#live-said") == ""


def test_an_exported_page_offers_no_capture_that_it_can_only_refuse(browser: Any, tmp_path: Path) -> None:
    assert _status(["export", str(EXAMPLE), "--to", "web", "-o", str(tmp_path / "site")]) == 0
    with hosted(tmp_path / "site") as link, opened(browser, link) as page:
        assert page.locator("#open").is_visible()
        assert page.locator("#capture-one").is_hidden()


def test_an_actuator_is_driven_in_its_own_unit(browser: Any, link: str, tmp_path: Path) -> None:
    write_profile(ActuatorProfile("coil", 80.0, 0.3, 40.0, "V", 5.0), tmp_path / "coil.json")
    (tmp_path / "other.json").write_text('{"format": "foten-actuator", "version": 1, "gain": 0}')
    with opened(browser, link) as page:
        page.click("#settings")
        page.set_input_files("#profile", tmp_path / "other.json")
        until(page, "document.querySelector('#actuator').value.includes('gain is 0')")
        page.set_input_files("#profile", tmp_path / "coil.json")
        until(page, "document.querySelector('#actuator').value === 'coil: 80 Hz'")
        assert page.input_value("#full-scale") == "5"  # what the amplifier and the coil bear
        page.fill("#full-scale", "2")
        assert page.evaluate(f"{STATE}.sound.scale({STATE}.sound.id)") == pytest.approx(0.5)
        page.keyboard.press("Escape")
        assert page.inner_text("#acceleration-name") == "drive"
        assert page.inner_text("#acceleration-unit") == "V"
        page.click("#settings")
        page.click("#profile-none")
        page.keyboard.press("Escape")
        assert page.inner_text("#acceleration-unit") == "m/s²"


def test_a_photo_is_on_its_swatch_and_what_is_no_picture_leaves_the_drawn_one(browser: Any, tmp_path: Path) -> None:
    mesh = read_texture(EXAMPLE)
    for name in ("tea #1", "towel"):
        write_texture(type(mesh)({**mesh.card, "texture": name}, mesh.tensors), tmp_path / f"{name}.foten")
    Image.new("RGB", (8, 8), "red").save(tmp_path / "tea #1.jpg")
    (tmp_path / "towel.jpg").write_bytes(b"no picture")
    with serving(str(tmp_path)) as (_, link), opened(browser, link, tap=False) as page:
        until(page, "document.querySelectorAll('#textures .painted').length === 2")
        pictures = page.evaluate(
            "Object.fromEntries([...document.querySelectorAll('#textures .swatch')]"
            ".map((one) => [one.dataset.id, one.style.backgroundImage]))"
        )
        assert "tea%20%231" in pictures["tea #1.foten"]
        assert pictures["towel.foten"].startswith('url("data:image/')


def test_it_is_accessible_and_one_tap_is_enough_to_hear_a_texture(browser: Any, link: str) -> None:
    with opened(browser, link, tap=False) as page:
        until(page, "[...document.querySelectorAll('#textures .swatch')].every((one) => one.style.backgroundImage)")
        complaints = look(page, "studio")
        page.click("#begin")
        until(page, "Number(document.querySelector('#acceleration').value) > 0.1")
        assert page.locator("#begin").is_hidden()
        complaints += look(page, "studio-stroke")
        page.click("#settings")
        complaints += look(page, "studio-settings")
        assert not complaints


def test_a_network_that_only_the_server_runs_is_heard_in_the_page(browser: Any, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    sizes = TRAINABLE["dstn"].sizes(excitation=True)
    write_texture(exported("dstn", sizes, texture="network"), tmp_path / "network.foten")
    with serving(str(tmp_path)) as (_, link), opened(browser, link, tap=False) as page:
        page.click("#begin")
        until(page, f"{STATE}.sound.server?.socket.readyState === 1")
        page.evaluate(f"{STATE}.pad.ghost = null")
        Pen(page).stroke(page)
        until(page, f"{STATE}.monitor.latest?.rms > 0")
        assert page.evaluate("document.querySelector('#path').value") == "stream"
