"""A study's TOML file: what is compared, by how many people, in which words."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from foten.untrusted import MAX_TOML, parse_toml, read_whole
from foten_study.languages import ENGLISH, Language, filled, read_language
from foten_study.orders import conditions
from foten_study.tasks.kind import Task, TaskKind, limited
from foten_study.tasks.rating import SIMILARITY
from foten_study.tasks.table import TASKS

WHEN = ("start", "end")
KINDS = ("text", "number", "choice", "slider")
MAX_SCALES = 4  # that a page has room for
MAX_PARTICIPANTS, MAX_TRIALS, MAX_ALL_TRIALS = 1000, 2000, 200_000
MAX_FILES = 200  # of textures: each is loaded, and rendered to match levels
MAX_TEXT_LENGTH = 8000  # characters
MAX_NUMBER = 1e15  # of an answer


@dataclass(frozen=True)
class Scale:
    """A scale of 0 to 100 on which a participant answers."""

    key: str
    question: str
    lowest: str  # 0
    highest: str  # 100


@dataclass(frozen=True)
class Setup:
    """How participants sit, as in Fig. 8 or all alone."""

    screens: int = limited(1, 1, 2)  # 2: they stroke on a tablet and answer on another screen
    operator: bool = False  # who lays down the real sample, and lets each trial begin
    real_side: str = limited(
        "right", "left", "right", "none"
    )  # of the virtual surface, where the real sample lies; Fig. 8
    real_checked: bool = False  # a trial is not rated before it was said that the real surface is touched
    show_names: bool = True  # of textures, to participants


@dataclass(frozen=True)
class Output:
    """What plays: `page` for the sound output of the tablet, or a device of the machine that serves."""

    to: str = "page"
    actuator: Path | None = None
    gain: float | None = None
    device: str | None = None
    channel: int | None = None
    volume_db: float = limited(0.0, -60, 24)  # of everything, the same for all participants


@dataclass(frozen=True)
class Noise:
    """White noise from a sound card of the machine that serves, which masks the actuator."""

    level_db: float = limited(-30.0, -90, 0)  # re full scale
    device: str | None = None


@dataclass(frozen=True)
class Question:
    """A question to participants."""

    key: str
    text: str
    kind: str = "text"
    options: tuple[str, ...] = ()
    low: float = -MAX_NUMBER  # that a number may be
    high: float = MAX_NUMBER
    at: str | int = "end"  # "start", "end", or after so many trials
    private: bool = False  # stored apart from the ratings, as age and gender are
    required: bool = True


@dataclass(frozen=True)
class Texture:
    """A surface, and the texture file of each method."""

    key: str
    name: str
    files: Mapping[str, Path]
    real: str = ""  # for the operator: which sample it is
    picture: Path | None = None


@dataclass(frozen=True)
class Design:
    """A study."""

    title: str
    textures: tuple[Texture, ...]
    participants: int = limited(21, 1, MAX_PARTICIPANTS)
    seed: int = limited(0, 0, 2**63 - 1)  # of the order of trials, stored before the first participant
    order: str = limited("balanced", "balanced", "random")  # by Latin squares, or as in Sec. VII
    practice: int = 2  # trials before those that count
    break_every: int = limited(16, 0, MAX_TRIALS)  # trials; 0 for none
    match_levels: bool = True  # methods of a texture are played equally loud
    language: Language = field(default_factory=read_language)  # that participants read
    instructions: str = ""  # those of the language
    consent: str = ""  # nothing is asked for without; {minutes} is how long it takes
    task: Task = field(default_factory=Task)
    scales: tuple[Scale, ...] = ()  # of the task `rating`; none for the one of similarity
    setup: Setup = field(default_factory=Setup)
    output: Output = field(default_factory=Output)
    noise: Noise | None = None
    questions: tuple[Question, ...] = ()

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods, in the order of the first texture."""
        return tuple(self.textures[0].files)

    @property
    def kind(self) -> TaskKind:
        """What there is to say of the task."""
        return TASKS[self.task.kind]

    @property
    def repeats(self) -> int:
        """How often each condition of a texture is asked."""
        return self.task.answers if self.kind.order.rounds else self.task.repeats

    @property
    def n_trials(self) -> int:
        """Number of a participant's trials that count."""
        return len(self.textures) * len(conditions(self.kind.order, len(self.methods))) * self.repeats

    @property
    def asked(self) -> tuple[Scale, ...]:
        """Scales of a trial; none where one of several surfaces is chosen."""
        if self.kind.choices:
            return ()
        return self.scales or (Scale(SIMILARITY, self.task.question, self.task.lowest, self.task.highest),)

    @property
    def n_surfaces(self) -> int:
        """Number of virtual surfaces in a trial."""
        return max(1, len(self.kind.intervals))

    @property
    def real_side(self) -> str:
        """Where the real surface lies; nowhere for a task that is about virtual ones alone."""
        return self.setup.real_side if self.kind.beside_real else "none"

    @property
    def minutes(self) -> int:
        """Minutes of a participant, where a trial is as long as the paper's, or a choice takes 20 s."""
        return max(1, round(self.n_trials * self.kind.minutes))


def read_design(path: Path) -> tuple[Design, str]:
    """Study in a TOML file, and the file's text; FileNotFoundError, or ValueError that says which field is wrong."""
    data = read_whole(path, 4 * MAX_TOML)
    try:
        text = data.decode()
        return _design(parse_toml(text), path.parent), text
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def task_of(text: str) -> Task:
    """Task of a study file's text, whatever became of the files that it names."""
    document = parse_toml(text)
    return _task(document, _language(document))


def _design(document: Mapping[str, Any], folder: Path) -> Design:
    tables = dict(document)
    textures, questions, scales = tables.pop("textures", {}), tables.pop("questions", []), tables.pop("scales", [])
    if not isinstance(textures, dict) or not isinstance(questions, list) or not isinstance(scales, list):
        raise ValueError("expected tables [textures.KEY], [[questions]] and [[scales]]")
    parts: dict[str, Any] = {
        name: _filled(kind, tables.pop(name), f"[{name}]", folder)
        for name, kind in {"setup": Setup, "output": Output, "noise": Noise}.items()
        if name in tables
    }
    parts["textures"] = tuple(_texture(key, table, folder) for key, table in textures.items())
    for name, kind, listed in (("question", Question, questions), ("scale", Scale, scales)):
        parts[f"{name}s"] = tuple(_filled(kind, one, f"{name} {i + 1}", folder) for i, one in enumerate(listed))
    language = parts["language"] = _language(tables)
    task = parts["task"] = _task(tables, language)
    design: Design = _filled(Design, tables, "the study", folder, **parts)
    _check(design)
    known = ["question", "min_seconds", *design.kind.settings]
    if unused := sorted(document.get("task", {}).keys() - {"kind", *known}):
        raise ValueError(
            f"[task] has {unused[0]!r}, which {task.kind} does not know, expected some of {', '.join(known)}"
        )
    consent = filled(design.consent, minutes=design.minutes)
    key = "scales" if len(design.scales) > 1 else task.kind
    instructions = design.instructions or language.words.get(f"instructions_{key}", language.words["instructions"])
    return replace(design, consent=consent, instructions=instructions)


def _language(tables: dict[str, Any]) -> Language:
    """Language of a study file, with the words that it says instead; both are taken out."""
    return read_language(tables.pop("language", ENGLISH), tables.pop("words", None))


def _task(tables: dict[str, Any], language: Language) -> Task:
    """Task of a study file, which is taken out, with the words of the language where it has none."""
    task: Task = _filled(Task, tables.pop("task", {}), "[task]", Path())
    _check_allowed("task: kind", task.kind, tuple(TASKS))
    keys = {"question": TASKS[task.kind].question(task), "lowest": "lowest", "highest": "highest"}
    texts: dict[str, Any] = {name: getattr(task, name) or language.words[key] for name, key in keys.items()}
    return replace(task, **texts)


def _texture(key: str, table: Any, folder: Path) -> Texture:
    where = f"[textures.{key}]"
    if not isinstance(table, dict) or not isinstance(table.get("methods"), dict):
        raise ValueError(f"{where} has no methods, expected [textures.{key}.methods] with a texture file for each")
    files = {}
    for method, file in table["methods"].items():
        if not isinstance(file, str) or not file:
            raise ValueError(f"{where}: {method} is {file!r:.40}, expected the name of a texture file")
        files[method] = folder / file
    others = {name: value for name, value in table.items() if name != "methods"}
    texture: Texture = _filled(Texture, {"name": titled(key), **others}, where, folder, key=key, files=files)
    return texture


_TYPE_NAMES = {
    "str": "text",
    "int": "an integer",
    "float": "a number",
    "bool": "true or false",
    "Path": "the name of a file",
    "tuple[str, ...]": "a list of texts",
}


def _filled(kind: type, table: Any, where: str, folder: Path, **parts: Any) -> Any:
    """A value of a kind with the fields of a table, each of its type, and parts that were read before."""
    if not isinstance(table, dict):
        raise ValueError(f"{where} is {table!r:.40}, expected a table")
    known = {known_field.name: known_field for known_field in fields(kind)}
    if unknown := sorted(table.keys() - (known.keys() - parts.keys())):
        raise ValueError(f"{where} has {unknown[0]!r}, expected some of {', '.join(known)}")
    values = dict(parts)
    for name, value in table.items():
        type_names = [kind_name for kind_name in str(known[name].type).split(" | ") if kind_name != "None"]
        values[name] = _converted(value, type_names, folder)
        if values[name] is None:
            raise ValueError(f"{where}: {name} is {value!r:.40}, expected {_TYPE_NAMES[type_names[0]]}")
        _check_allowed(name, values[name], known[name].metadata.get("allowed"))
    for name, known_field in known.items():
        if name not in values and known_field.default is MISSING and known_field.default_factory is MISSING:
            raise ValueError(f"{where}: {name} is missing")
    return kind(**values)


def _converted(value: Any, type_names: list[str], folder: Path) -> Any:
    """A TOML value as a field of some types has it; None where it is of another."""
    is_text = isinstance(value, str) and len(value) <= MAX_TEXT_LENGTH
    if is_text and "Path" in type_names:
        return folder / value
    if type(value) is int and "float" in type_names:
        return float(value)
    if isinstance(value, list) and "tuple[str, ...]" in type_names and all(isinstance(text, str) for text in value):
        return tuple(value)
    return value if type(value).__name__ in type_names and (is_text or not isinstance(value, str)) else None


def _check(design: Design) -> None:
    if len(design.textures) < 1:
        raise ValueError("there is no texture, expected [textures.KEY] for each")
    methods, task = design.methods, design.task
    if len(methods) < design.kind.min_methods:
        raise ValueError(f"texture {design.textures[0].key} has {len(methods)} method, expected two or more to compare")
    for texture in design.textures:
        if set(texture.files) != set(methods):
            other = sorted(set(texture.files) ^ set(methods))[0]
            raise ValueError(
                f"texture {texture.key} and texture {design.textures[0].key} do not have the same methods: one lacks {other}"
            )
        _check_different([str(file) for file in texture.files.values()], f"methods of {texture.key} with one file")
    _check_different([texture.name for texture in design.textures], "textures with one name")
    _check_different(list(methods), "methods with one name")
    _check_different([question.key for question in design.questions], "questions with one key")
    _check_different([scale.key for scale in design.scales], "scales with one key")
    if len(design.scales) > MAX_SCALES:
        raise ValueError(f"there are {len(design.scales)} [[scales]], expected {MAX_SCALES} at most")
    if wrong := [scale.key for scale in design.scales if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", scale.key)]:
        raise ValueError(f"the key of a scale is {wrong[0]!r:.40}, expected letters, digits and _, a letter first")
    if design.scales and design.kind.choices:
        raise ValueError(f"there are [[scales]], and the task is {task.kind}: they belong to the task rating")
    n_trials = design.n_trials
    for name, value, bounds in (
        ("trials", n_trials, (2, MAX_TRIALS)),
        ("the trials of all participants", n_trials * design.participants, (2, MAX_ALL_TRIALS)),
        ("the number of texture files", len(design.textures) * len(methods), (1, MAX_FILES)),
        ("practice", design.practice, (0, n_trials)),
        ("low_db", task.low_db, (-90, task.high_db - 4)),
    ):
        _check_allowed(name, value, bounds)
    for question in design.questions:
        _check_question(question, n_trials)


def _check_allowed(name: str, value: Any, allowed: tuple[Any, ...] | None) -> None:
    """Refuse a number beyond its bounds, or a text that is none of some."""
    if allowed is None:
        return
    if isinstance(allowed[0], str):
        if value not in allowed:
            raise ValueError(f"{name} is {value!r:.40}, expected {', '.join(allowed[:-1])} or {allowed[-1]}")
    elif not allowed[0] <= value <= allowed[1]:
        raise ValueError(f"{name} is {value:,.10g}, expected {allowed[0]:,g} to {allowed[1]:,g}")


def _check_question(question: Question, n_trials: int) -> None:
    where = f"question {question.key}"
    if question.kind not in KINDS:
        raise ValueError(f"{where}: kind is {question.kind!r:.40}, expected one of {', '.join(KINDS)}")
    if (question.kind == "choice") != (len(question.options) >= 2):
        raise ValueError(f"{where}: a choice has two options or more, and nothing else has any")
    low, high = question.low, question.high
    is_bounded = (low, high) != (-MAX_NUMBER, MAX_NUMBER)
    if not -MAX_NUMBER <= low < high <= MAX_NUMBER or (is_bounded and question.kind != "number"):
        raise ValueError(f"{where}: low and high are {low:g} and {high:g}, expected bounds of a number in order")
    if question.at not in WHEN and not (isinstance(question.at, int) and 1 <= question.at < n_trials):
        raise ValueError(f"{where}: at is {question.at!r:.40}, expected start, end, or after how many trials")


def _check_different(names: list[str], what: str) -> None:
    """Refuse equal names: people, and some file systems, do not see capitals."""
    seen: dict[str, str] = {}
    for name in names:
        if name.casefold().strip() in seen:
            raise ValueError(f"there are two {what}: {name!r:.80} and {seen[name.casefold().strip()]!r:.80}")
        seen[name.casefold().strip()] = name


def titled(name: str) -> str:
    """A texture's name as people write it, and as the page of textures does: `steel-mesh-1`, "Steel mesh 1"."""
    words = " ".join(name.replace("-", " ").replace("_", " ").split())
    return words[:1].upper() + words[1:] or name
