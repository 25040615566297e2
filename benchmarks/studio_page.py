"""The page in Chromium: from a pen's event to the sample that knows of it, from a tap to sound, and one quantum of the kernel.

    python benchmarks/studio_page.py [--seconds 20] [--csv FILE]

Events come 240 a second. `to the graph` is without the audio device, `to the speaker` with what the browser says of it; without
a sound card it has a device of its own. A quantum is 128 samples of the largest texture that comes along, through WebAssembly
beside this machine's own kernel in the same run.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from bench import browser_page, parser_of, report, served
from foten.runtime.renderer import EXAMPLE, Renderer
from foten.runtime.stylus import Stylus

RATE_HZ, QUANTUM, N = 48_000.0, 128, 20_000
LARGEST = max(EXAMPLE.parent.glob("*.foten"), key=lambda path: path.stat().st_size)

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


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    arguments = parser.parse_args()
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
    report(cells, arguments.csv)


if __name__ == "__main__":
    main()
