"""A user's profile: how strongly she feels five frequencies through her actuator, and how she likes textures moved.

The filter has the gains by which tones of five frequencies feel as strong as one of 160 Hz. Source: ours; equal thresholds of
acceleration from 40 to 250 Hz after Verrillo, J. Acoust. Soc. Am. 35 (1963), as in `dsp.perception`.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from foten.atomic_write import write_json
from foten.editing.describe import describe, reference, steady_figures
from foten.editing.edit import UNMEASURED, Edit, edited, evidence_of, with_level
from foten.editing.tool import MAX_GAIN_DB, Transfer, filtered
from foten.models.texture_file import Texture
from foten.untrusted import is_number, read_profile_json

FORMAT, VERSION = "foten-user", 1
TONES_HZ = (40.0, 63.0, 100.0, 160.0, 250.0)
FOR_USER = "for the user "
MAX_ANSWERS = 10_000  # a session has 200
REFERENCE_HZ = 160.0  # whose gain is 0
MOVES = {"level": 6.0, "brighter": 0.75, "wider": 0.3, "rougher": 1.5}
"""Half of the range of each move: dB, octaves, octaves, dB of the envelope. Five just noticeable differences, as is assumed."""


Answer = tuple[str, tuple[float, ...], int]
"""Part ("detect", "compare", or "match:" and a texture's name), what was shown, and the number of what was chosen."""


@dataclass(frozen=True)
class UserProfile:
    """What is known of a user with an actuator. Levels are amplitudes."""

    name: str = ""
    actuator: str = ""  # its name; empty for an output whose acceleration is not known
    unit: str = "full scale"  # that levels are re: full scale of the output, or m/s²
    max_db: tuple[float, ...] = (0.0,) * len(TONES_HZ)  # the largest tones at `TONES_HZ`, which answers are relative to
    volume_db: float = 0.0  # of the page as the texture was matched, where no actuator is known
    threshold_db: tuple[float, ...] = ()  # at `TONES_HZ`; empty where they were not measured
    threshold_sd_db: tuple[float, ...] = ()
    gain_db: tuple[float, ...] = ()  # by which the tones feel as strong as the one of `REFERENCE_HZ`
    gain_sd_db: tuple[float, ...] = ()
    texture: str = ""  # that was matched to a surface; empty where none was
    moves: tuple[float, ...] = ()  # of `MOVES`, in their units
    moves_sd: tuple[float, ...] = ()
    answers: tuple[Answer, ...] = ()  # all that were given

    def __post_init__(self) -> None:
        if not all(isinstance(text, str) for text in (self.name, self.actuator, self.unit, self.texture)):
            raise ValueError("name, actuator, unit and texture of the user are text")
        n, k = len(TONES_HZ), len(MOVES)
        sizes = {"threshold_db": n, "threshold_sd_db": n, "gain_db": n, "gain_sd_db": n, "moves": k, "moves_sd": k}
        for name, size in {**sizes, "max_db": n}.items():
            values = getattr(self, name)
            if len(values) != size and not (name in sizes and not values):
                raise ValueError(f"{name} of the user has {len(values)} figures, expected {size}")
            if not all(map(is_number, values)):
                raise ValueError(f"a figure of {name} of the user is no finite number")
        if not is_number(self.volume_db):
            raise ValueError("volume_db of the user is no finite number")
        if any(abs(gain) > MAX_GAIN_DB for gain in self.gain_db):
            raise ValueError(f"a gain of the user is beyond {MAX_GAIN_DB:g} dB")
        for move, (name, limit) in zip(self.moves, MOVES.items(), strict=False):
            if abs(move) > limit:
                raise ValueError(f"{name} of the user is {move:g}, expected {-limit:g} to {limit:g}")
        if len(self.answers) > MAX_ANSWERS:
            raise ValueError(f"it has {len(self.answers)} answers, expected {MAX_ANSWERS} at most")
        for answer in self.answers:
            if not _is_answer(*answer):
                raise ValueError(f"an answer of the user is {str(answer)[:60]}, which is none to any question")

    def in_words(self) -> list[str]:
        """What is known, a line each."""

        def figures(values: tuple[float, ...]) -> str:
            return ", ".join(f"{hz:g} Hz {db:+.0f}" for hz, db in zip(TONES_HZ, values, strict=True))

        lines = []
        if self.threshold_db:
            sd = max(self.threshold_sd_db)
            lines.append(f"felt from {figures(self.threshold_db)} dB re {self.unit}, to {sd:.0f} dB")
        if self.gain_db:
            sd = max(self.gain_sd_db)
            lines.append(f"as strong as {REFERENCE_HZ:g} Hz with {figures(self.gain_db)} dB, to {sd:.0f} dB")
        if self.moves:
            at = "" if self.actuator else f", at a volume of {self.volume_db:g} dB"
            lines.append(f"{self.texture} is most like its surface with {self.edit.in_words() or 'no change'}{at}")
        return lines

    @property
    def transfer(self) -> Transfer | None:
        """The filter of the gains; None where they were not measured."""
        if not self.gain_db:
            return None
        return Transfer("", self.name, TONES_HZ, self.gain_db, self.gain_sd_db, speed_mm_s=100.0, force_n=0.7)

    @property
    def edit(self) -> Edit:
        """The moves; none where none were chosen."""
        level, brighter, wider, rougher = self.moves or (0.0,) * len(MOVES)
        return Edit(level_db=level, brighter=brighter, wider=wider, rougher=rougher)


def _is_answer(part: str, shown: tuple[float, ...], which: int) -> bool:
    """Whether an answer is one to a question of a part."""
    if not all(map(is_number, shown)):
        return False
    if part == "detect":
        return len(shown) == 3 and shown[0] in TONES_HZ and which in range(3)
    if part == "compare":
        return len(shown) == 4 and {shown[0], shown[2]} <= set(TONES_HZ) and which in range(2)
    return part.startswith("match:") and len(shown) in range(2, 2 * len(MOVES) + 1, 2) and which in range(2)


def adapted(texture: Texture, profile: UserProfile) -> Texture:
    """The texture as a user with an actuator is given it, proved; ValueError where it is one already, or nothing was measured."""
    if FOR_USER in texture.evidence:
        raise ValueError("the texture is one for a user already")
    edit, equalised = profile.edit, equal_strength(texture, profile)
    if edit == Edit():
        if equalised is texture:
            raise ValueError("the user's profile is empty: nothing was measured")
        return equalised
    before = describe(equalised)
    width = max(edit.wider, 0.05 - before.width_octaves)  # moves were chosen on another texture, which was wider
    result = edited(equalised, replace(edit, wider=width))
    how = f"{'a filter, ' if profile.transfer else ''}{edit.in_words()}"
    how += f", as far as it goes ({'; '.join(result.unreached)})" if result.unreached else ""
    words = _words(texture, profile, how)
    return Texture({**result.texture.card, "evidence": words}, result.texture.tensors)


def equal_strength(texture: Texture, profile: UserProfile) -> Texture:
    """The texture through the filter of a user's gains, as loud as it was where it is described."""
    transfer = profile.transfer
    if transfer is None:
        return texture
    at = replace(transfer, speed_mm_s=reference(texture, "speed"), force_n=reference(texture, "force"))
    out = filtered(texture, at, "", texture.card["tool"])
    out = with_level(out, 20 * float(np.log10(steady_figures(texture).rms / steady_figures(out).rms)))
    return Texture({**out.card, "evidence": _words(texture, profile, "a filter")}, out.tensors)


def _words(texture: Texture, profile: UserProfile, how: str) -> str:
    """What the card says of a texture for a user."""
    return evidence_of(texture, f"{FOR_USER}{profile.name or 'nameless'}: {how}, {UNMEASURED}")


def write_user(profile: UserProfile, path: Path) -> None:
    """Write a profile as JSON, whole or not at all."""
    write_json(path, {"format": FORMAT, "version": VERSION, "tones_hz": list(TONES_HZ), **asdict(profile)})


def read_user(path: Path) -> UserProfile:
    """The profile in a file, or ValueError where it is none."""
    content = read_profile_json(path, FORMAT, VERSION, "a user's profile of 'foten adapt'")
    if content.pop("tones_hz", None) != list(TONES_HZ):
        raise ValueError(f"{path.name} is of other frequencies, expected {', '.join(f'{hz:g}' for hz in TONES_HZ)} Hz")
    try:
        answers = [(str(part), tuple(map(float, shown)), int(which)) for part, shown, which in content.pop("answers")]
        lists = {name: tuple(value) for name, value in content.items() if isinstance(value, list)}
        return UserProfile(**{**content, **lists, "answers": tuple(answers)})
    except (TypeError, KeyError, ValueError) as error:
        raise ValueError(f"{path.name} is no user's profile: {error}") from None
