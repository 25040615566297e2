"""Server of the page on which a user is measured: one session, whose profile is written after each answer."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp

from foten.atomic_write import reason
from foten.editing.describe import Description, describe
from foten.editing.edit import Edit, moved_by
from foten.editing.envelope import STRENGTHS, EnvelopeCurve
from foten.editing.user import MOVES, TONES_HZ, adapted, equal_strength, write_user
from foten.models.texture_file import Texture
from foten.runtime.actuator import ActuatorProfile
from foten.studio.access import Access, Guarded
from foten.studio.page_files import page_files
from foten.studio.studio_server import missing, page_file
from foten.untrusted import parse_json
from foten_study.adapt_session import FULL_RANGES, Question, Session

PAGES = Path(__file__).with_name("adapt_pages")
MIN_ROUGHER_DB = 0.3  # of the envelope: what can be changed by less is left out
VOLUMES_DB = (-40.0, 12.0)
KNEE = 0.8  # of an actuator's limit, from which on the drive bends


def largest_tones_db(actuator: ActuatorProfile | None) -> tuple[float, ...]:
    """Amplitude of the largest tones at `TONES_HZ`: dB re 1 m/s² with an actuator, else re full scale."""
    if actuator is None:
        return (0.0,) * len(TONES_HZ)
    drive = KNEE * actuator.limit if actuator.limit else 1.0
    return tuple(20 * float(np.log10(drive * actuator.acceleration(hertz))) for hertz in TONES_HZ)


def reachable(texture: Texture) -> dict[str, tuple[float, float]]:
    """From where to where each of `MOVES` changes a texture: its envelope has bounds of its own."""
    curve, ranges = EnvelopeCurve(texture), dict(FULL_RANGES)
    low, high = ranges.pop("rougher")
    plain = curve.roughness_db[STRENGTHS.index(0.0)]
    reached = max(low, float(curve.roughness_db[0] - plain)), min(high, float(curve.roughness_db[-1] - plain))
    return ranges | ({"rougher": reached} if reached[1] - reached[0] >= MIN_ROUGHER_DB else {})


class AdaptServer:
    """A session, with the texture that is matched, None for thresholds and gains alone, and the file of the profile."""

    def __init__(
        self, session: Session, output: Path, texture: Texture | None = None, actuator: ActuatorProfile | None = None
    ) -> None:
        self.session, self.output, self.texture, self.actuator = session, output, texture, actuator
        self._matched: tuple[Texture, Description, EnvelopeCurve] | None = None  # heard through the user's gains
        self._pair: tuple[int, tuple[bytes, bytes]] | None = None
        self._one = asyncio.Lock()
        # Where an actuator is known, what is rendered is an acceleration, and has one volume.
        self._volume_set = actuator is not None or any(part.startswith("match:") for part, *_ in session.answers)

    def app(self, access: Access) -> ASGIApp:
        """Application, behind its access."""
        routes = [
            Route("/session", self._state),
            Route("/answer", self._answer, methods=["POST"]),
            Route("/pair/{n}/{which}", self._moved),
            Route("/textures/{kind}.foten", self._texture),
            Route("/{name:path}", self._file),
        ]
        return Guarded(Starlette(routes=routes), access)

    def state(self) -> dict[str, Any]:
        """What the page has to show."""
        question, profile, coil = self.session.question, self.session.profile, self.actuator
        actuator = None
        if coil is not None:
            full_scale = 1.0 if coil.unit == "full scale" else coil.limit or 1.0
            actuator = {**asdict(coil), "full_scale": full_scale, "knee": KNEE if coil.limit else 1.0}
        return {
            "question": None if question is None else _for_page(question),
            "progress": self.session.progress,
            "matched": self.session.preference.n_answers,
            "can_stop": self.session.preference.n_answers >= self.session.limits.match[0],
            "texture": self.session.texture,
            "silent": self.session.silent,
            "volume_set": self._volume_set,
            "actuator": actuator,
            "tones_hz": list(TONES_HZ),
            "moves": dict(MOVES),
            "profile": {name: value for name, value in asdict(profile).items() if name != "answers"},
            "file": self.output.name,
        }

    async def _state(self, _request: Request) -> Response:
        return JSONResponse(self.state())

    async def _answer(self, request: Request) -> Response:
        try:
            message = parse_json(await request.body())  # as long as `web_server` lets it be
            if not isinstance(message, dict):
                raise ValueError("the answer is no object")
            async with self._one:
                self._take(message)
                await asyncio.to_thread(write_user, self.session.profile, self.output)
        except (ValueError, OSError) as error:
            why = reason(error) if isinstance(error, OSError) else str(error)
            return PlainTextResponse(f"{why}\n", status_code=409)
        return JSONResponse(self.state())

    def _take(self, message: Mapping[str, Any]) -> None:
        if message.get("stop") is True:
            if self.session.preference.n_answers < self.session.limits.match[0]:
                raise ValueError(f"{self.session.limits.match[0]} choices are the fewest that say something")
            self.session.stop()
            return
        if (volume_db := message.get("volume_db")) is not None:
            low, high = VOLUMES_DB
            if isinstance(volume_db, bool) or not isinstance(volume_db, int | float) or not low <= volume_db <= high:
                raise ValueError(f"the volume is {volume_db!r:.20}, expected {low:g} to {high:g} dB")
            if self._volume_set:
                raise ValueError("the volume stays as it was when the first pair was compared")
            self.session.set_volume(float(volume_db))
            self._volume_set = True
            return
        n, which = message.get("n"), message.get("which")
        if type(n) is not int or type(which) is not int:
            raise ValueError("an answer has n and which, whole numbers")
        self.session.answer(n, which)

    async def _moved(self, request: Request) -> Response:
        n, which = request.path_params["n"], request.path_params["which"]
        async with self._one:
            question = self.session.question
            # Compared as texts: Python refuses to read a number of more than 4300 digits.
            if question is None or question.part != "match" or n != str(question.n) or which not in ("0", "1"):
                return missing("there is no such pair now")
            try:
                if self._pair is None or self._pair[0] != question.n:
                    self._pair = question.n, await asyncio.to_thread(self._made, question)
            except ValueError as error:
                return missing(f"cannot be matched: {error}")
            return Response(self._pair[1][int(which)], media_type="application/octet-stream")

    def _made(self, question: Question) -> tuple[bytes, bytes]:
        if self._matched is None:
            assert self.texture is not None
            base = equal_strength(self.texture, self.session.profile)
            self._matched = base, describe(base), EnvelopeCurve(base)
        first, second = np.split(np.array(question.shown), 2)
        return self._changed(*self.session.moves(first)), self._changed(*self.session.moves(second))

    def _changed(self, level: float, brighter: float, wider: float, rougher: float) -> bytes:
        """The matched texture with moves, roughly: a search would take seconds."""
        assert self._matched is not None
        base, before, curve = self._matched
        width = max(wider, 0.05 - before.width_octaves)
        edit = Edit(level_db=level, brighter=brighter, wider=width, rougher=rougher)
        return moved_by(base, edit, before, n_steps=1, curve=curve).to_bytes()

    async def _texture(self, request: Request) -> Response:
        """The texture as it is, as strong at all frequencies, and as the profile has it."""
        plain = self.texture
        if plain is None:
            return missing("there is no texture here")
        kinds: dict[str, Callable[[], Texture]] = {
            "plain": lambda: plain,
            "equal": lambda: equal_strength(plain, self.session.profile),
            "adapted": lambda: adapted(plain, self.session.profile),
        }
        if (kind := request.path_params["kind"]) not in kinds:
            return missing("there is no such texture here")
        try:
            async with self._one:
                texture = await asyncio.to_thread(kinds[kind])
        except ValueError as error:
            return missing(str(error))
        return Response(texture.to_bytes(), media_type="application/octet-stream")

    async def _file(self, request: Request) -> Response:
        files = page_files() | {path.name: path for path in PAGES.iterdir() if path.is_file()}
        return page_file(files, request.path_params["name"] or "adapt.html")


def _for_page(question: Question) -> dict[str, Any]:
    """A question as the page shows it: tones by interval, None for silence; a pair is fetched."""
    shown = question.shown
    out: dict[str, Any] = {"n": question.n, "part": question.part}
    if question.part == "detect":
        hertz, level, interval = shown
        out["tones"] = [[hertz, level] if i == interval else None for i in range(question.n_choices)]
    elif question.part == "compare":
        out["tones"] = [list(shown[:2]), list(shown[2:])]
    return out
