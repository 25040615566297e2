"""A study ready to run: its file, its stimuli, the output, its database, which has to be of this very file; and what runs."""

import asyncio
import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from foten.console import check_files
from foten.models.texture_file import read_texture
from foten.runtime.actuator import read_profile
from foten.runtime.renderer import Renderer
from foten.studio.levels import gains_db
from foten.studio.players import OutputDevice, Player, RoundRobinRenderer, white_noise
from foten.untrusted import check_regular, read_whole
from foten_study.design import Design, Output, read_design
from foten_study.orders import Trial, planned
from foten_study.store import Store
from foten_study.study_file import Stimulus, create

LSL_NAME, LSL_KIND = "foten-study", "Markers"  # of a stream of the Lab Streaming Layer
DOUBTFUL_GAIN_DB = 10.0
MAX_PICTURES_BYTES = 2**28  # of all pictures of a study, which stay in memory
PICTURE = re.compile(  # the beginning of a file, by media type
    rb"(?P<png>\x89PNG\r\n\x1a\n.{4}IHDR)|(?P<jpeg>\xff\xd8\xff)|(?P<webp>RIFF.{4}WEBP)|(?P<gif>GIF8[79]a)", re.DOTALL
)


def load_stimuli(
    design: Design, calibrated: bool, loaded: Sequence[Sequence[Renderer]]
) -> tuple[list[Stimulus], dict[tuple[int, int], bytes], list[str]]:
    """Stimuli of a study, their files, and doubts: of files by texture and method, with gains [dB] of methods to be equally loud.

    Equally loud is equal power over nine conditions (`gains_db`). Without matching, methods keep their recorded levels. A
    calibrated output takes m/s², another one shares of each file's own standard deviation. ValueError where methods of a
    texture are in different units, or are the same file.
    """
    listed: list[Stimulus] = []
    bytes_of: dict[tuple[int, int], bytes] = {}
    doubts: list[str] = []
    for t, (texture, renderers) in enumerate(zip(design.textures, loaded, strict=True)):
        units = {read_texture(path).unit for path in texture.files.values()}
        if len(units) > 1:
            raise ValueError(f"methods of {texture.key} are in different units: {', '.join(sorted(units))}")
        data = [read_whole(path) for path in texture.files.values()]
        scales = [1.0 if calibrated else 1 / r.native_texture.info.acceleration_sd for r in renderers]
        gains = [20 * math.log10(scales[0] / scale) for scale in scales]
        if design.match_levels:
            gains = gains_db(renderers, scales)
            doubts += [
                f"{method} of {texture.key} is {-gain:+.0f} dB beside the other methods: does it fall silent?"
                for method, gain in zip(texture.files, gains, strict=True)
                if abs(gain) > DOUBTFUL_GAIN_DB
            ]
        digests = [hashlib.sha256(file).hexdigest() for file in data]
        if len(set(digests)) < len(digests):
            raise ValueError(f"two methods of {texture.key} are the same file")
        for m, (method, digest, gain) in enumerate(zip(texture.files, digests, gains, strict=True)):
            listed.append(Stimulus(t, m, texture.key, method, digest, gain))
            bytes_of[t, m] = data[m]
    return listed, bytes_of, doubts


@dataclass(frozen=True)
class Study:
    """A study file, and what it names."""

    path: Path
    text: str
    design: Design
    stimuli: list[Stimulus]
    bytes_of: Mapping[tuple[int, int], bytes]  # of texture files, by texture and method
    levels_doubted: list[str]
    output: OutputDevice | None  # None where the pages play
    pictures: Mapping[str, tuple[str, bytes]]  # media type and bytes, by the number of the texture

    @property
    def doubts(self) -> list[str]:
        """What a person should know before the first participant."""
        name, reviewed = self.design.language.name, self.design.language.reviewed
        return [*self.levels_doubted, *([] if reviewed else [f"the {name} texts have not been reviewed by a speaker"])]

    def orders(self) -> list[list[Trial]]:
        """Trials of the participants, and of some more for those who leave."""
        design, counts = self.design, (len(self.design.textures), len(self.design.methods))
        task = design.kind.order, design.repeats
        return planned(design.participants, *counts, design.seed, design.practice, design.order, *task)

    def noise(self) -> AbstractContextManager[Any]:
        """A context in which white noise plays, where the study asks for it."""
        noise = self.design.noise
        return nullcontext() if noise is None else white_noise(noise.level_db, noise.device)

    def check_devices(self) -> None:
        """Open what plays once, and give it back."""
        if self.output is not None:
            self.output.check()
        with self.noise():
            pass

    def open_store(self, database: Path, simulated: bool = False) -> Store:
        """Database of this study, new or begun; ValueError where the file is of another, or simulated as this is not."""
        if not database.exists():
            check_files([database])
            design = (self.design.title, self.text, self.path.parent, self.design.seed)
            create(database, *design, self.stimuli, self.orders(), simulated)
        store = Store(database)
        try:
            self._check_is_of_this_study(store, simulated)
        except BaseException:
            store.close()
            raise
        return store

    def _check_is_of_this_study(self, store: Store, simulated: bool) -> None:
        database = store.path
        if store.simulated != simulated:
            has = "simulated" if store.simulated else "real"
            raise ValueError(f"{database} holds {has} ratings, which stay apart: give another name with -o")
        if store.study["design"] != self.text:
            raise ValueError(
                f"{self.path} has changed since {database} was begun: bring it back, or begin another with -o"
            )
        then = {key: stimulus.sha256 for key, stimulus in store.stimuli().items()}
        others = [s for s in self.stimuli if then.get((s.texture, s.method)) != s.sha256]
        if others:
            which = f"{others[0].method_key} of {others[0].texture_key} is another file than when {database} was begun"
            raise ValueError(f"{which}: bring it back, or begin another")


class Markers:
    """Markers in a stream of the Lab Streaming Layer (Kothe et al., Imaging Neuroscience 3, 2025), each a JSON object.

    Methods are not named: whoever watches the stream stays blind. ValueError without pylsl, OSError without its library.
    """

    def __init__(self, title: str) -> None:
        try:
            import pylsl
        except ImportError as error:
            raise ValueError("--lsl needs pylsl: pip install './packages/foten-study[lsl]'") from error
        except RuntimeError as error:
            raise OSError(f"pylsl does not find its library, liblsl: {str(error).splitlines()[0]}") from error
        info = pylsl.StreamInfo(LSL_NAME, LSL_KIND, 1, pylsl.IRREGULAR_RATE, "string", f"{LSL_NAME}-{title}")
        self._outlet = pylsl.StreamOutlet(info)

    def send(self, event: str, **about: Any) -> None:
        """Send a marker; it is stamped now."""
        self._outlet.push_sample([json.dumps({"event": event, **about})])


class RunningStudy:
    """A study with its database, and what plays; `markers` takes what happens in trials."""

    def __init__(self, store: Store, study: Study, markers: Markers | None = None) -> None:
        self.store, self.design, self.output, self.bytes_of = store, study.design, study.output, study.bytes_of
        self.markers = markers
        self.gains = {key: stimulus.gain_db for key, stimulus in store.stimuli().items()}
        self.player: Callable[[float], Player] = (study.output or RoundRobinRenderer()).player
        # One thread: SQLite waits for the disk, which the sound must not.
        self.disk = ThreadPoolExecutor(1, thread_name_prefix="foten-store")

    @property
    def plays_in_page(self) -> bool:
        """Whether pages play, and not a device of this machine."""
        return self.output is None

    async def on_disk(self, work: Callable[[], Any]) -> Any:
        """Result of some work with the database."""
        return await asyncio.get_running_loop().run_in_executor(self.disk, work)


def load_study(path: Path) -> Study:
    """Study in a TOML file; FileNotFoundError or ValueError as `read_design` and `load_stimuli`, and of all files at once."""
    design, text = read_design(path)
    faults: list[str] = []
    output = _read(_output_device, design.output, faults)
    loaded = [[_read(Renderer, file, faults) for file in texture.files.values()] for texture in design.textures]
    picture = partial(_picture, path.parent.resolve(), MAX_PICTURES_BYTES // len(design.textures))
    pictures = {str(t): _read(picture, one.picture, faults) for t, one in enumerate(design.textures) if one.picture}
    if faults:
        raise ValueError(f"{path.name}: {'; '.join(faults)}")
    stimuli = load_stimuli(design, output is not None and output.calibrated, loaded)
    return Study(path, text, design, *stimuli, output, pictures)


def _read(read: Callable[[Any], Any], what: Any, faults: list[str]) -> Any:
    """What is read; where it cannot be, a fault is added."""
    try:
        return read(what)
    except (OSError, ValueError) as error:
        faults.append(str(error) if not isinstance(what, Path) or what.name in str(error) else f"{what.name}: {error}")


def _picture(folder: Path, max_bytes: int, path: Path) -> tuple[str, bytes]:
    """Media type and bytes of a picture, which is read once: what lies there later is never served."""
    check_regular(path)
    path = path.resolve()
    if not path.is_relative_to(folder):
        raise ValueError(f"{path} lies outside of the study file's folder, expected a picture inside: copy it there")
    with path.open("rb") as file:
        data = file.read(max_bytes + 1)
    if (begins := PICTURE.match(data)) is None or len(data) > max_bytes:
        raise ValueError(f"{path.name}: expected a picture, PNG, JPEG, WebP or GIF, of at most {max_bytes // 1000} kB")
    return f"image/{begins.lastgroup}", data


def _output_device(output: Output) -> OutputDevice | None:
    if output.to != "page":
        profile = None if output.actuator is None else read_profile(output.actuator)
        return OutputDevice(output.to, profile, output.gain, output.device, output.channel)
    if any(value is not None for value in (output.actuator, output.gain, output.device, output.channel)):
        raise ValueError("[output] plays in the page, which has no device, gain or actuator of this machine")
    return None
