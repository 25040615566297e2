"""A study's TOML file, read and written anew: what is compared, by how many people, in which words."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path
from string import Template
from typing import Any

from foten.models.texture_file import read_texture
from foten.study.languages import ENGLISH, Language, filled, read_language
from foten.study.orders import SWAPPED, conditions
from foten.untrusted import MAX_TOML, parse_toml, read_whole

WHEN = ("start", "end")
KINDS = ("text", "number", "choice", "slider")
SIDES = ("left", "right", "none")
ORDERS = ("balanced", "random")
CHOICES = {"paired": ("A", "B"), "abx": ("A", "B"), "oddity": ("1", "2", "3"), "threshold": ("1", "2", "3")}
TASKS = ("rating", *CHOICES)
FEEDBACK = ("none", "practice", "all")
MEASURES = ("detection", "difference")
KEYS = {  # of [task], beside kind, question and min_seconds
    "rating": ("lowest", "highest"),
    "paired": ("repeats",),
    "abx": ("repeats", "feedback"),
    "oddity": ("repeats", "feedback"),
    "threshold": ("feedback", "measures", "answers", "low_db", "high_db"),
}
MAX_SCALES = 4  # that a page has room for
CHOICE = "choice"  # key of an answer that is one of several
QUESTIONS = {  # keys of words
    "paired": "which_nearer",
    "abx": "which_x",
    "oddity": "which_odd",
    "detection": "which_felt",
    "difference": "which_stronger",
}
MAX_PARTICIPANTS, MAX_TRIALS, MAX_ALL_TRIALS = 1000, 2000, 200_000
MAX_FILES = 200  # of textures: each is loaded, and rendered to match levels
MAX_TEXT_LENGTH = 8000  # characters
MAX_NUMBER = 1e15  # of an answer
MINUTES_PER_RATING = 90 / 48  # Sec. VII: 90 minutes for 48 comparisons
MINUTES_PER_CHOICE = 1 / 3  # of one of two or three surfaces; assumed
TRIALS_OF_NEW = 24  # of a new study of choices, about
TEMPLATE = Path(__file__).with_name("new_study.toml")


@dataclass(frozen=True)
class Scale:
    """A scale of 0 to 100 on which a participant answers."""

    key: str
    question: str
    lowest: str  # 0
    highest: str  # 100


@dataclass(frozen=True)
class Task:
    """What a participant does in a trial; empty texts are those of the study's language.

    - rating: one surface, on one scale or several.
    - paired: two methods of a texture: which is nearer to the real surface?
    - abx: two methods and X, which is one of both: which?
    - oddity: three surfaces, one of them by another method: which?
    - threshold: three surfaces; one vibrates, or vibrates more, at a level that follows the answers.
    """

    kind: str = "rating"
    question: str = ""
    lowest: str = ""  # 0
    highest: str = ""  # 100, as in Sec. VII
    min_seconds: float = 0.0  # of a trial, before an answer is taken
    repeats: int = 1  # of each comparison
    feedback: str = "practice"  # whether the answer was right, where one is
    measures: str = "detection"  # of a threshold: or the difference in level that is just noticeable
    answers: int = 25  # to each threshold
    low_db: float = (
        -60.0
    )  # of what a threshold's trials play: re the recorded level, or of the increment re the pedestal
    high_db: float = 0.0


@dataclass(frozen=True)
class Setup:
    """How participants sit, as in Fig. 8 or all alone."""

    screens: int = 1  # 2: they stroke on a tablet and answer on another screen
    operator: bool = False  # who lays down the real sample, and lets each trial begin
    real_side: str = "right"  # of the virtual surface, where the real sample lies; Fig. 8
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
    volume_db: float = 0.0  # of everything, the same for all participants


@dataclass(frozen=True)
class Noise:
    """White noise from a sound card of the machine that serves, which masks the actuator."""

    level_db: float = -30.0  # re full scale
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
    participants: int = 21
    seed: int = 0  # of the order of trials, stored before the first participant
    order: str = "balanced"  # by Latin squares, or "random" as in Sec. VII
    practice: int = 2  # trials before those that count
    break_every: int = 16  # trials; 0 for none
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
    def repeats(self) -> int:
        """How often each condition of a texture is asked."""
        return self.task.answers if self.task.kind == "threshold" else self.task.repeats

    @property
    def n_trials(self) -> int:
        """Number of a participant's trials that count."""
        n = len(self.methods)
        return len(self.textures) * (math.comb(n, 2) if self.task.kind in SWAPPED else n) * self.repeats

    @property
    def asked(self) -> tuple[Scale, ...]:
        """Scales of a trial; none where one of several surfaces is chosen."""
        return asked_in(self.task, self.scales)

    @property
    def real_side(self) -> str:
        """Where the real surface lies; nowhere for a task that is about virtual ones alone."""
        return self.setup.real_side if self.task.kind in ("rating", "paired") else "none"

    @property
    def minutes(self) -> int:
        """Minutes of a participant, where a trial is as long as the paper's, or a choice takes 20 s."""
        return max(1, round(self.n_trials * (MINUTES_PER_RATING if self.task.kind == "rating" else MINUTES_PER_CHOICE)))


def read_design(path: Path) -> tuple[Design, str]:
    """Study in a TOML file, and the file's text.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is no TOML, a field is missing, unknown or out of range, or the textures cannot be compared.
    """
    data = read_whole(path, 4 * MAX_TOML)
    try:
        text = data.decode()
        return _design(parse_toml(text), path.parent), text
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def task_of(text: str) -> tuple[Task, tuple[Scale, ...]]:
    """Task and scales of a study file's text, whatever became of the files that it names."""
    document = parse_toml(text)
    task = _worded(_filled(Task, document.get("task", {}), "[task]", Path()), _language(document))
    scales = tuple(
        _filled(Scale, table, f"scale {i + 1}", Path()) for i, table in enumerate(document.get("scales", []))
    )
    return task, asked_in(task, scales)


def asked_in(task: Task, scales: tuple[Scale, ...]) -> tuple[Scale, ...]:
    """Scales of a trial; none where one of several surfaces is chosen."""
    if task.kind != "rating":
        return ()
    return scales or (Scale("similarity", task.question, task.lowest, task.highest),)


def _design(document: Mapping[str, Any], folder: Path) -> Design:
    tables = dict(document)
    textures, questions, scales = tables.pop("textures", {}), tables.pop("questions", []), tables.pop("scales", [])
    if not isinstance(textures, dict) or not isinstance(questions, list) or not isinstance(scales, list):
        raise ValueError("expected tables [textures.KEY], [[questions]] and [[scales]]")
    parts: dict[str, Any] = {
        name: _filled(kind, tables.pop(name), f"[{name}]", folder)
        for name, kind in {"task": Task, "setup": Setup, "output": Output, "noise": Noise}.items()
        if name in tables
    }
    parts["textures"] = tuple(_texture(key, table, folder) for key, table in textures.items())
    parts["questions"] = tuple(
        _filled(Question, table, f"question {i + 1}", folder) for i, table in enumerate(questions)
    )
    parts["scales"] = tuple(_filled(Scale, table, f"scale {i + 1}", folder) for i, table in enumerate(scales))
    language = parts["language"] = _language(tables)
    task = parts["task"] = _worded(parts.get("task", Task()), language)
    design: Design = _filled(Design, tables, "the study", folder, **parts)
    _check(design)
    if unused := sorted(document.get("task", {}).keys() - {"kind", "question", "min_seconds", *KEYS[task.kind]}):
        known = ", ".join(["question", "min_seconds", *KEYS[task.kind]])
        raise ValueError(f"[task] has {unused[0]!r}, which {task.kind} does not know, expected some of {known}")
    consent = filled(design.consent, minutes=design.minutes)
    key = "scales" if len(design.scales) > 1 else task.kind
    instructions = design.instructions or language.words.get(f"instructions_{key}", language.words["instructions"])
    return replace(design, consent=consent, instructions=instructions)


def _language(tables: dict[str, Any]) -> Language:
    """Language of a study file, with the words that it says instead; both are taken out."""
    return read_language(tables.pop("language", ENGLISH), tables.pop("words", None))


def _worded(task: Task, language: Language) -> Task:
    """A task with the words of the language where it has none."""
    key = QUESTIONS.get(task.measures if task.kind == "threshold" else task.kind, "question")
    texts = {"question": language.words[key], "lowest": language.words["lowest"], "highest": language.words["highest"]}
    question, lowest, highest = (getattr(task, name) or text for name, text in texts.items())
    return replace(task, question=question, lowest=lowest, highest=highest)


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
    if len(methods) < 2 and task.kind != "threshold":
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
    if design.scales and task.kind != "rating":
        raise ValueError(f"there are [[scales]], and the task is {task.kind}: they belong to the task rating")
    bounds: dict[str, tuple[float, float, float]] = {
        "participants": (design.participants, 1, MAX_PARTICIPANTS),
        "repeats": (task.repeats, 1, 100),
        "answers": (task.answers, 8, 200),
        "trials": (design.n_trials, 2, MAX_TRIALS),
        "the trials of all participants": (design.n_trials * design.participants, 2, MAX_ALL_TRIALS),
        "the number of texture files": (len(design.textures) * len(methods), 1, MAX_FILES),
        "seed": (design.seed, 0, 2**63 - 1),
        "practice": (design.practice, 0, design.n_trials),
        "break_every": (design.break_every, 0, MAX_TRIALS),
        "min_seconds": (task.min_seconds, 0, 600),
        "low_db": (task.low_db, -90, task.high_db - 4),
        "high_db": (task.high_db, -86, 24),
        "screens": (design.setup.screens, 1, 2),
        "volume_db": (design.output.volume_db, -60, 24),
    }
    if design.noise is not None:
        bounds["level_db"] = (design.noise.level_db, -90, 0)
    for name, (value, low, high) in bounds.items():
        if not low <= value <= high:
            raise ValueError(f"{name} is {value:,.10g}, expected {low:,g} to {high:,g}")
    chosen = {"order": (design.order, ORDERS), "real_side": (design.setup.real_side, SIDES)}
    chosen |= {
        "task: kind": (task.kind, TASKS),
        "feedback": (task.feedback, FEEDBACK),
        "measures": (task.measures, MEASURES),
    }
    for name, (text, choices) in chosen.items():
        if text not in choices:
            raise ValueError(f"{name} is {text!r:.40}, expected {', '.join(choices[:-1])} or {choices[-1]}")
    for question in design.questions:
        _check_question(question, design.n_trials)


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


def study_text(
    title: str,
    textures: Mapping[str, Mapping[str, str]],
    participants: int,
    seed: int,
    language: str = ENGLISH,
    task: str = "rating",
) -> str:
    """Text of a study file of a task in a language, for textures by name, each with its files by method."""
    lines = []
    for name, files in textures.items():
        key = _key(name)
        lines += ["", f"[textures.{key}]", f"name = {_quoted(titled(name))}"]
        lines += ['real = ""               # which sample the operator lays down', f"[textures.{key}.methods]"]
        lines += [f"{_key(method)} = {_quoted(file)}" for method, file in files.items()]
    texts = read_language(language)
    values = {name: _quoted(text) for name, text in {**texts.words, **texts.new, "title": title}.items()}
    values |= {"participants": str(participants), "seed": str(seed), "language": _quoted(language)}
    instructions = texts.words.get(f"instructions_{task}", texts.words["instructions"])
    values |= {
        "task": _task_lines(task, values, textures),
        "instructions": instructions,
        "consent": texts.new["consent"],
    }
    text = Template(TEMPLATE.read_text(encoding="utf-8")).substitute(values) + "\n".join(lines) + "\n"
    return text if task in ("rating", "paired") else re.sub("^real_.*\n", "", text, flags=re.M)


def titled(name: str) -> str:
    """A texture's name as people write it, and as the page of textures does: `steel-mesh-1`, "Steel mesh 1"."""
    words = " ".join(name.replace("-", " ").replace("_", " ").split())
    return words[:1].upper() + words[1:] or name


def repeats_of_new(task: str, n_textures: int, n_methods: int) -> int:
    """How often each comparison of a new study is asked, for about `TRIALS_OF_NEW` trials."""
    return max(1, round(TRIALS_OF_NEW / (n_textures * len(conditions(task, n_methods)))))


def _task_lines(task: str, texts: Mapping[str, str], textures: Mapping[str, Mapping[str, str]]) -> str:
    """Lines of a new study file about its task, of texts as TOML has them."""
    lines = [f'kind = "{task}"'.ljust(24) + "# or " + ", ".join(kind for kind in TASKS if kind != task)]
    if task == "rating":
        lines += [f"{name} = {texts[name]}" for name in ("question", "lowest", "highest")]
    elif task == "threshold":
        lines += ['measures = "detection"  # or "difference": the difference in level that is just noticeable']
        lines += ["answers = 25            # to each threshold, of each method on each texture"]
    else:
        repeats = repeats_of_new(task, len(textures), len(next(iter(textures.values()))))
        lines += [f"repeats = {repeats}".ljust(24) + "# of each pair of methods on each texture"]
    if task in ("abx", "oddity", "threshold"):
        lines += ['feedback = "practice"   # says whether an answer was right: none, practice or all']
    return "\n".join(lines)


def files_by_method(
    paths: Sequence[Path], folder: Path, min_methods: int = 2
) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Texture files by texture and method, as seen from a folder, and textures that lack a method and are left out.

    The texture is that of a file's card, the method its model; where two files of a texture have one model, the method is what
    their names have beside the texture's: mesh-slow, mesh-quick.

    Raises:
        ValueError: a file is no texture file, or there is one method alone.
    """
    models_of: dict[str, dict[Path, str]] = {}
    for path in paths:
        card = read_texture(path).card
        models_of.setdefault(str(card["texture"]) or path.stem, {})[path] = str(card["model"])
    if any(len(set(models.values())) < len(models) for models in models_of.values()):
        models_of = {
            name: {path: path.stem.removeprefix(name).strip("-_. ") or model for path, model in models.items()}
            for name, models in models_of.items()
        }
    usual = max((frozenset(models.values()) for models in models_of.values()), key=len)
    if len(usual) < min_methods:
        name = next(iter(models_of))
        raise ValueError(f"{name} has one method, expected two texture files or more of each texture, to compare")
    incomplete = [name for name, models in models_of.items() if frozenset(models.values()) != usual]
    files: dict[str, dict[str, str]] = {name: {} for name in models_of if name not in incomplete}
    for name, of_name in files.items():
        for path, method in sorted(models_of[name].items(), key=lambda item: item[1]):
            of_name[method] = os.path.relpath(path, folder)
    doubts = [f"left out {name}: it does not have each of {', '.join(sorted(usual))}" for name in incomplete]
    return files, doubts


def _key(name: str) -> str:
    return name if name.isascii() and name.replace("-", "").replace("_", "").isalnum() else _quoted(name)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")  # TOML escapes this one too
