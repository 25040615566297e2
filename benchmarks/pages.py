"""The pages and their servers: from a pen to the sample, twenty pages that stroke at once, and a study of 100 participants.

    python benchmarks/pages.py page [--seconds 20] [--csv FILE]
    python benchmarks/pages.py load [--pages 20] [--events 200] [--seconds 60] [--csv FILE]
    python benchmarks/pages.py study [--participants 100] [--csv FILE]

`page` is that of `foten serve` in Chromium: from a pen's event to the sample that knows of it, from a tap to sound, and one
quantum of the kernel. Events come 240 a second. `to the graph` is without the audio device, `to the speaker` with what the
browser says of it; without a sound card it has a device of its own. A quantum is 128 samples of the largest texture that comes
along, through WebAssembly beside this machine's own kernel in the same run.

`load` says what of the events of many pages arrives, and which deadlines are missed. Each page is a WebSocket whose events are
sent on time, and whose vibration is received. The pages are another process than the server, on the same cores. Beside it the
same for one page alone, in the same run.

`study` is how long a study takes to open: the operator's page and the report, in Chromium; and to be analysed. Twelve textures by
four methods, under other names those that come along, rated by simulated raters.
"""

import argparse
import asyncio
import json
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import websockets

from bench import FOTEN, browser_page, parser_of, report, served
from foten.models.texture_file import read_texture, write_texture
from foten.runtime.renderer import EXAMPLE, Renderer
from foten.runtime.stylus import Stylus

RATE_HZ, QUANTUM, N = 48_000, 128, 20_000
LARGEST = max(EXAMPLE.parent.glob("*.foten"), key=lambda path: path.stat().st_size)
TEXTURES, METHODS = 12, ("ar", "dstn", "ldhtd", "foten")

STROKE = """async ({ seconds, hz }) => {
  const { pad, sound } = window.studio, canvas = document.querySelector("#pad"), box = canvas.getBoundingClientRect();
  canvas.setPointerCapture = () => {};
  const say = (type, x, y) => canvas.dispatchEvent(new PointerEvent(type, { pointerId: 7, pointerType: "pen", pressure: 0.5,
    clientX: box.left + x, clientY: box.top + y, bubbles: true, buttons: 1 }));
  sound.delays.length = 0;
  const begin = performance.now();
  await new Promise((resolve) => {
    let k = 0;
    const step = () => {
      const due = (performance.now() - begin) / 1000 * hz;
      for (; k < due; k++) say(k ? "pointerrawupdate" : "pointerdown", 300 + 150 * Math.sin(k / 40), 200);
      if (k < seconds * hz) setTimeout(step, 1);
      else resolve(say("pointerup", 300, 200));
    };
    step();
  });
  return sound.latency;
}"""

QUANTA = """async ({ rate, quantum, n, file }) => {
  const { Foten } = await import("/foten.mjs");
  const foten = Foten.start(await WebAssembly.compile(await (await fetch("/foten.wasm")).arrayBuffer()));
  const texture = foten.texture(await (await fetch(`/textures/${file}`)).arrayBuffer());
  const renderer = texture.renderer({ rate }), stylus = renderer.stylus(), out = new Float32Array(quantum), took = [];
  for (let k = 0; k < n; k++) {
    const t = (k * quantum) / rate;
    stylus.push(50 + 40 * Math.sin(5 * t), 20, 0.5, t);
    const begin = performance.now();
    renderer.renderStylus(stylus, out);
    took.push(performance.now() - begin);
  }
  return took;
}"""


def native_quanta(path: Path) -> list[float]:
    """How long each quantum takes with this machine's kernel [ms]."""
    renderer = Renderer(path.read_bytes(), rate=RATE_HZ)
    stylus, out, took = Stylus(renderer), np.zeros(QUANTUM, dtype=np.float32), []
    for k in range(N):
        t = k * QUANTUM / RATE_HZ
        stylus.push(50 + 40 * np.sin(5 * t), 20.0, 0.5, t)
        begin = time.perf_counter()
        stylus.render_into(out)
        took.append(1000 * (time.perf_counter() - begin))
    return took


def first_changes(path: Path, n: int = 200) -> list[float]:
    """How long after an event that says something else the first sample differs [ms]: of two pens that did the same."""
    delays = []
    for k in range(n):
        pens = [Stylus(Renderer(path.read_bytes(), rate=RATE_HZ)) for _ in range(2)]
        at = 40 + k  # quanta: the texture's own samples lie anywhere in them
        for i in range(at):
            for pen in pens:
                pen.push(0.08 * 1000 * i * QUANTUM / RATE_HZ, 20.0, 0.5, i * QUANTUM / RATE_HZ)
                pen.render(QUANTUM)
        for pen, pressure in zip(pens, (0.5, 0.7), strict=True):
            pen.push(0.08 * 1000 * at * QUANTUM / RATE_HZ, 20.0, pressure, at * QUANTUM / RATE_HZ)
        same, other = (pen.render(48 * 20) for pen in pens)
        delays.append(1000 * int(np.argmax(np.abs(same - other) > 1e-6 * np.abs(same).max())) / RATE_HZ)
    return delays


def measured(page: Any, link: str, seconds: float) -> tuple[list[float], dict[str, float], list[float]]:
    """The times to first sound [ms], the latencies, and how long a quantum takes in the page [ms]."""
    first = []
    for _ in range(5):
        page.goto(link)
        page.wait_for_selector("html[data-ready]")
        first.append(
            page.evaluate(
                """() => new Promise((resolve) => {
                  const begin = performance.now();
                  const first = ({ detail }) => detail.rms > 1e-6 && resolve(performance.now() - begin);
                  window.studio.sound.addEventListener("report", first);
                  document.querySelector("#begin").click();
                })"""
            )
        )
    page.evaluate("() => { window.studio.pad.ghost = null; }")
    latency = page.evaluate(STROKE, {"seconds": seconds, "hz": 240})
    quanta = page.evaluate(QUANTA, {"rate": RATE_HZ, "quantum": QUANTUM, "n": N, "file": LARGEST.name})
    return first, latency, quanta


def page_table(arguments: argparse.Namespace) -> list[list[str]]:
    """Delays of the page, and how long a quantum takes."""
    with served("serve") as link, browser_page("--autoplay-policy=no-user-gesture-required") as page:
        first, latency, quanta = measured(page, link, arguments.seconds)
    native, changes = native_quanta(LARGEST), first_changes(EXAMPLE)
    longer = np.median(quanta) / np.median(native)

    def two(values: list[float]) -> list[str]:
        return [f"{np.percentile(values, share):.3f}" for share in (50, 99)]

    cells = [["", "median [ms]", "99 % [ms]", "of"]]
    cells.append(["tap to first sound", f"{np.median(first):.0f}", f"{max(first):.0f} (most)", f"{len(first)} loads"])
    for name, key in (("event to the graph", "own"), ("event to the speaker", "total")):
        shares = (f"{latency[f'{key}{share}']:.1f}" for share in ("P50", "P99"))
        cells.append([name, *shares, f"{latency['n']:.0f} events"])
    of_changes = f"{len(changes)} events, in the texture's own rate"
    cells.append(["graph to the first changed sample", *two(changes), of_changes])
    cells.append(["a quantum in WebAssembly", *two(quanta), f"{1000 * QUANTUM / RATE_HZ:.3f} ms that it plays"])
    cells.append(["the same, native", *two(native), f"{longer:.2f} times as long in WebAssembly"])
    return cells


async def stroked(link: str, index: int, events_hz: float, seconds: float, begin: float) -> dict[str, Any]:
    """Stroke for some seconds, and return what was sent, what came back, and the server's last word on it."""
    received, state = 0, {}
    sent, latest = 0, 0.0
    async with websockets.connect(
        f"ws{link[4:]}stroke", additional_headers={"Origin": link.rstrip("/")}, compression=None
    ) as socket:
        await socket.send(json.dumps({"do": "open", "texture": EXAMPLE.name, "rate_hz": RATE_HZ}))

        async def listen() -> None:
            nonlocal received, state
            async for message in socket:
                if isinstance(message, bytes):
                    received += (len(message) - 8) // 4
                else:
                    reply = json.loads(message)
                    if "refused" in reply:
                        sys.exit(f"page {index}: {reply['refused']}")
                    state = reply.get("state", state)

        listening = asyncio.create_task(listen())
        n = round(events_hz * seconds)
        for k in range(n):
            due = begin + (k + index / 20) / events_hz
            if (wait := due - time.monotonic()) > 0:
                await asyncio.sleep(wait)
            latest = max(latest, time.monotonic() - due)
            t = k / events_hz
            x = 50.0 + 40.0 * np.sin(2 * np.pi * 0.7 * t + index)
            await socket.send(np.array([x, 20.0, 0.5, t]).astype("<f8").tobytes())
            sent += 1
        await asyncio.sleep(1.6)  # until the server has reported once more
        listening.cancel()
    return {"sent": sent, "late_ms": 1000 * latest, "received_s": received / RATE_HZ, **state}


async def all_stroke(link: str, pages: int, events_hz: float, seconds: float) -> list[dict[str, Any]]:
    """What each of some pages says that stroke at once."""
    begin = time.monotonic() + 2.0
    return await asyncio.gather(*(stroked(link, i, events_hz, seconds, begin) for i in range(pages)))


def row(name: str, link: str, pages: int, events_hz: float, seconds: float) -> list[str]:
    """A line of the table."""
    results = asyncio.run(all_stroke(link, pages, events_hz, seconds))
    with urllib.request.urlopen(f"{link}state") as answer:
        assert json.load(answer)["n_refused"] == 0
    blocks = sum(page["received_s"] for page in results) * 1000 / results[0]["block_ms"]
    return [
        name,
        f"{sum(page['sent'] for page in results):,}",
        f"{sum(page['sent'] - page['n_events'] for page in results)}",
        f"{100 * sum(page['n_missed'] for page in results) / blocks:.3f} %",
        f"{np.median([page['block_p50_ms'] for page in results]):.2f}",
        f"{max(page['block_p99_ms'] for page in results):.2f}",
        f"{sum(page['n_unsent'] for page in results)}",
    ]


def load_table(arguments: argparse.Namespace) -> list[list[str]]:
    """What one page and many lose and miss."""
    cells = [
        ["pages", "events sent", "lost", "deadlines missed", "block p50 [ms]", "block p99 [ms]", "blocks not sent"]
    ]
    with served("serve") as link:
        for pages in (1, arguments.pages):
            cells.append(row(str(pages), link, pages, arguments.events, arguments.seconds))
    return cells


def foten(*arguments: str | Path) -> None:
    """Run a command of `foten study`."""
    subprocess.run([*FOTEN, "study", *arguments], check=True, capture_output=True)


def prepared(folder: Path, participants: int) -> Path:
    """A study's file in a folder, with its simulated ratings beside it."""
    sources = [read_texture(path) for path in sorted(EXAMPLE.parent.glob("*.foten"))]
    for t in range(TEXTURES):
        for m, method in enumerate(METHODS):
            source = sources[(t + m) % len(sources)]
            card = {**source.card, "texture": f"surface-{t + 1}", "licence": method}
            write_texture(type(source)(card, source.tensors), folder / f"surface-{t + 1}-{method}.foten")
    study = folder / "study.toml"
    files = sorted(folder.glob("*.foten"))
    foten("new", study, *files, "--participants", str(participants))
    foten("simulate", study, "-o", folder / "study.db")
    return study


def study_table(arguments: argparse.Namespace) -> list[list[str]]:
    """Seconds to analyse a study, and to open its report and the operator's page."""
    cells = [["", "seconds", "of"]]
    with tempfile.TemporaryDirectory() as name, browser_page() as page:
        folder = Path(name)
        study = prepared(folder, arguments.participants)
        ratings = f"{arguments.participants * TEXTURES * len(METHODS):,} ratings"
        begin = time.perf_counter()
        foten("analyze", folder / "study.db", "-o", folder / "results")
        cells.append(["foten study analyze", f"{time.perf_counter() - begin:.1f}", ratings])
        begin = time.perf_counter()
        page.goto((folder / "results" / "report.html").as_uri(), wait_until="load")
        page.wait_for_selector("figure svg >> nth=1")
        cells.append(["the report, opened", f"{time.perf_counter() - begin:.2f}", ratings])
        with served("study", "run", study, "--simulated", link=r"http\S+operator\S+") as link:
            begin = time.perf_counter()
            page.goto(link)
            page.wait_for_selector(f"#people li >> nth={arguments.participants - 1}", state="attached")
            taken = time.perf_counter() - begin
        cells.append(["the operator's page, opened", f"{taken:.2f}", f"{arguments.participants} participants"])
    return cells


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("what", choices=("page", "load", "study"))
    parser.add_argument("--pages", type=int, default=20)
    parser.add_argument("--events", type=float, default=200.0, help="of each page (1/s)")
    parser.add_argument("--seconds", type=float, help="of strokes; 20 of the page, 60 of many")
    parser.add_argument("--participants", type=int, default=100)
    arguments = parser.parse_args()
    arguments.seconds = arguments.seconds or (20.0 if arguments.what == "page" else 60.0)
    table = {"page": page_table, "load": load_table, "study": study_table}[arguments.what]
    report(table(arguments), arguments.csv)


if __name__ == "__main__":
    main()
