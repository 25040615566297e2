"""A study before its participants: a new one's TOML file from texture files, how many people it needs, simulated ones."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from foten.models.texture_file import read_texture
from foten_study.design import Design, titled
from foten_study.languages import ENGLISH, read_language
from foten_study.orders import conditions, square
from foten_study.store import Store
from foten_study.tasks.kind import Plan, Rated, Task
from foten_study.tasks.table import TASKS

TRIALS_OF_NEW = 24  # of a new study of choices, about
PARTICIPANTS_OF_ONE = 12  # where there is nothing to compare
MAX_CYCLE = 48  # participants, of squares that a new study fills
MANY = 40  # participants of a new study that would need more than are simulated
TEMPLATE = Path(__file__).with_name("new_study.toml")


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
    repeats = repeats_of_new(task, len(textures), len(next(iter(textures.values()))))
    values |= {"instructions": instructions, "consent": texts.new["consent"]}
    values["task"] = _task_lines(task, values, repeats)
    text = Template(TEMPLATE.read_text(encoding="utf-8")).substitute(values) + "\n".join(lines) + "\n"
    return text if TASKS[task].beside_real else re.sub("^real_.*\n", "", text, flags=re.M)


def repeats_of_new(task: str, n_textures: int, n_methods: int) -> int:
    """How often each comparison of a new study is asked, for about `TRIALS_OF_NEW` trials."""
    return max(1, round(TRIALS_OF_NEW / (n_textures * len(conditions(TASKS[task].order, n_methods)))))


def participants_for(task: str, methods: int, textures: int) -> tuple[int, int | None]:
    """Participants of a new study, in complete squares where these are small, and how many find its effect, if 60 do."""
    kind, repeats = TASKS[task], repeats_of_new(task, textures, methods)
    if methods * textures < 2:
        return PARTICIPANTS_OF_ONE, None
    n = kind.power(Plan(Task(task, repeats=repeats), methods, textures, kind.effect), kind.n_studies[1], 0).needed
    many, cycle = n or MANY, square(textures, len(conditions(kind.order, methods, repeats)))
    return (-(-many // cycle) * cycle if cycle <= MAX_CYCLE else many), n


def _task_lines(task: str, texts: Mapping[str, str], repeats: int) -> str:
    """Lines of a new study file about its task, of texts as TOML has them."""
    kind = TASKS[task]
    lines = [f'kind = "{task}"'.ljust(24) + "# or " + ", ".join(other for other in TASKS if other != task)]
    lines += [line.format_map(texts) for line in kind.new_lines]
    if "repeats" in kind.settings:
        lines.append(f"repeats = {repeats}".ljust(24) + "# of each pair of methods on each texture")
    if "feedback" in kind.settings:
        lines.append('feedback = "practice"   # says whether an answer was right: none, practice or all')
    return "\n".join(lines)


def files_by_method(
    paths: Sequence[Path], folder: Path, min_methods: int = 2
) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Texture files by texture and method, as seen from a folder, and textures that lack a method and are left out.

    The texture is that of a file's card, the method its model; where two files of a texture have one model, the method is what
    their names have beside the texture's: mesh-slow, mesh-quick. ValueError where there are too few methods.
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


def simulate_study(store: Store, design: Design, missing: float, seed: int, **people: Any) -> None:
    """Let people, as `Plan` describes them, answer all that a design asks; a share of them leaves before the end."""
    rng, kind, n = np.random.default_rng(seed), design.kind, design.participants
    scales = tuple(scale.key for scale in design.asked)
    plan = Plan(design.task, len(design.methods), len(design.textures), scales=scales, **people)
    person = kind.simulate(plan, n, rng)
    for i in range(n):
        number = store.join(f"SIM{i + 1:03d}")
        trials = [trial for trial in store.trials(number) if not (trial.practice and kind.order.rounds)]
        n_done = len(trials) if rng.random() >= missing else int(rng.integers(1, len(trials)))
        answer = person(i, float(rng.standard_normal()))
        rated = {}
        for trial in trials[:n_done]:
            values, measured = answer(trial)
            rated[f"trial:{trial.number}"] = Rated(values, float(rng.gamma(9, 2.5)), 0, measured)
        store.take_steps(number, rated)
