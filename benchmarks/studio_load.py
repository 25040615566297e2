"""Twenty pages stroke at the server at once: what of their events arrives, and which deadlines are missed.

    python benchmarks/studio_load.py [--pages 20] [--events 200] [--seconds 60] [--csv FILE]

Each page is a WebSocket whose events are sent on time, and whose vibration is received. The pages are another process than the
server, on the same cores. Beside it the same for one page alone, in the same run.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
import urllib.request
from typing import Any

import numpy as np
import websockets

from bench import parser_of, report, served

TEXTURE = "steel-mesh-1.foten"
RATE_HZ = 48_000


async def stroked(link: str, index: int, events_hz: float, seconds: float, begin: float) -> dict[str, Any]:
    """Stroke for some seconds, and return what was sent, what came back, and the server's last word on it."""
    received, state = 0, {}
    sent, latest = 0, 0.0
    async with websockets.connect(
        f"ws{link[4:]}stroke", additional_headers={"Origin": link.rstrip("/")}, compression=None
    ) as socket:
        await socket.send(json.dumps({"do": "open", "texture": TEXTURE, "rate_hz": RATE_HZ}))

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


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--pages", type=int, default=20)
    parser.add_argument("--events", type=float, default=200.0, help="of each page (1/s)")
    parser.add_argument("--seconds", type=float, default=60.0)
    arguments = parser.parse_args()
    cells = [
        ["pages", "events sent", "lost", "deadlines missed", "block p50 [ms]", "block p99 [ms]", "blocks not sent"]
    ]
    with served("serve") as link:
        for pages in (1, arguments.pages):
            cells.append(row(str(pages), link, pages, arguments.events, arguments.seconds))
    report(cells, arguments.csv)


if __name__ == "__main__":
    main()
