"""Answers to a study's questions, checked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from foten.studio.messages import RefusedError
from foten_study.design import Question
from foten_study.languages import Language

MAX_ANSWER_LENGTH = 2000  # characters


def checked_answers(
    questions: Sequence[Question], answers: Any, language: Language
) -> tuple[dict[str, str], dict[str, str]]:
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
        if not isinstance(answer, str) or len(answer) > MAX_ANSWER_LENGTH or not _is_text(answer):
            raise RefusedError(f"{question.text}: expected up to {MAX_ANSWER_LENGTH} characters of text")
        answer = answer.strip()
        if not answer:
            if question.required:
                raise RefusedError(language.say("answer_missing", question=question.text))
            continue
        if question.kind in ("number", "slider"):
            if not _is_number(answer):
                raise RefusedError(language.say("not_a_number", question=question.text))
            low, high = (0, 100) if question.kind == "slider" else (question.low, question.high)
            if not low <= float(answer) <= high:
                raise RefusedError(language.say("not_a_number", question=f"{question.text} ({low:g}–{high:g})"))
        if question.kind == "choice" and answer not in question.options:
            raise RefusedError(f"{question.text}: {answer[:40]!r} is none of the choices")
        (private if question.private else public)[question.key] = answer
    return public, private


def _is_text(text: str) -> bool:
    """Whether a text can be stored: half of a surrogate pair cannot."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
