"""Steps of a participant: consent, questions, instructions, trials and breaks, and which answers a questionnaire takes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from foten.studio.messages import RefusedError
from foten.study.design import Design, Question
from foten.study.orders import Trial

MAX_ANSWER_LENGTH = 2000  # characters
Step = dict[str, Any]  # with an `id` and a `kind`


def steps_of(design: Design, trials: Sequence[Trial]) -> list[Step]:
    """Steps of a participant with these trials, in order."""
    steps: list[Step] = []
    if design.consent.strip():
        steps.append({"id": "consent", "kind": "consent", "text": design.consent})
    steps += _questions(design.questions, "start")
    steps.append({"id": "instructions", "kind": "instructions", "text": design.instructions})
    counted = sum(not trial.practice for trial in trials)
    for trial in trials:
        n = trial.number
        steps.append({"id": f"trial:{n}", "kind": "trial", "n": n, "of": counted, "trial": trial})
        if n < 1 or n == counted:
            continue
        steps += _questions(design.questions, n)
        if design.break_every and n % design.break_every == 0:
            steps.append({"id": f"break:{n}", "kind": "break", "n": n, "of": counted})
    return [*steps, *_questions(design.questions, "end"), {"id": "end", "kind": "end"}]


def _questions(questions: Sequence[Question], at: str | int) -> list[Step]:
    asked = [question for question in questions if question.at == at]
    return [{"id": f"questions:{at}", "kind": "questions", "questions": asked}] if asked else []


def public_step(step: Step, design: Design) -> Step:
    """What a participant's page gets of a step: nothing of methods."""
    public: Step = {name: value for name, value in step.items() if name not in ("trial", "questions")}
    if step["kind"] == "questions":
        public["questions"] = [
            {"key": q.key, "text": q.text, "kind": q.kind, "options": list(q.options), "required": q.required}
            for q in step["questions"]
        ]
    if step["kind"] == "trial":
        trial: Trial = step["trial"]
        texture, rating, setup = design.textures[trial.texture], design.rating, design.setup
        public |= {"practice": trial.practice, "real_side": setup.real_side, "screens": setup.screens}
        public |= {"question": rating.question, "lowest": rating.lowest, "highest": rating.highest}
        public |= {"min_s": rating.min_seconds}
        if setup.show_names:
            public |= {"name": texture.name, "picture": f"pictures/{trial.texture}" if texture.picture else None}
    return public


def checked_answers(questions: Sequence[Question], answers: Any) -> tuple[dict[str, str], dict[str, str]]:
    """Answers of a questionnaire by question, those that are not private and those that are.

    Raises:
        RefusedError: an answer is missing, or is none to its question.
    """
    public: dict[str, str] = {}
    private: dict[str, str] = {}
    if not isinstance(answers, dict):
        raise RefusedError("answers are no object")
    for question in questions:
        answer = answers.get(question.key, "")
        if not isinstance(answer, str) or len(answer) > MAX_ANSWER_LENGTH:
            raise RefusedError(f"{question.text}: expected up to {MAX_ANSWER_LENGTH} characters")
        answer = answer.strip()
        if not answer:
            if question.required:
                raise RefusedError(f"{question.text}: an answer is missing")
            continue
        if question.kind in ("number", "slider") and not _is_number(answer):
            raise RefusedError(f"{question.text}: {answer[:40]!r} is no number")
        if question.kind == "choice" and answer not in question.options:
            raise RefusedError(f"{question.text}: {answer[:40]!r} is none of the choices")
        (private if question.private else public)[question.key] = answer
    return public, private


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
