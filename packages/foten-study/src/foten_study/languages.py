"""What participants read, in their language: the tables of languages.toml, and what a study file says instead."""

import difflib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from foten.studio.page_files import PAGE
from foten.untrusted import parse_toml

TABLES = Path(__file__).with_name("languages.toml")
ENGLISH = "en"
MAX_WORDS_LENGTH = 8000  # characters


@dataclass(frozen=True)
class Language:
    """A language, and all that participants read in it."""

    code: str
    name: str  # in English
    dir: str  # `ltr` or `rtl`
    reviewed: bool  # by a speaker
    words: Mapping[str, str]  # while a study runs
    new: Mapping[str, str]  # of a new study file

    def say(self, key: str, **values: object) -> str:
        """Words with values in the place of `{names}`."""
        return filled(self.words[key], **values)


def filled(text: str, **values: object) -> str:
    """Text with values in the place of `{names}`; a name without a value stays."""
    return re.sub(r"\{(\w+)\}", lambda match: str(values.get(match[1], match[0])), text)


def read_language(code: str = ENGLISH, instead: Any = None) -> Language:
    """Language of a code, with a study file's words by key instead of some; ValueError where one is missing or does not fit."""
    tables = _tables()
    if not isinstance(code, str) or code not in tables:
        raise ValueError(f"language is {code!r:.40}, expected one of {', '.join(tables)}")
    table, words = tables[code], dict(tables[code]["words"])
    for part in ("words", "new"):
        _check(f"{TABLES.name}: {table['name']}", table[part], tables[ENGLISH][part])
    if not isinstance(instead, dict | None):
        raise ValueError(f"[words] is {instead!r:.40}, expected a table")
    for key, text in (instead or {}).items():
        if key not in words:
            near = difflib.get_close_matches(key, words, 1, 0.0)[0]
            raise ValueError(f"[words] has {key!r:.40}, expected a key of {TABLES.name}: is {near!r} meant?")
        if not isinstance(text, str) or not 0 < len(text.strip()) <= MAX_WORDS_LENGTH:
            raise ValueError(f"[words]: {key} is {text!r:.40}, expected text")
        words[key] = text
    _check("[words]", words, table["words"])
    return Language(code, table["name"], table["dir"], table["reviewed"], words, table["new"])


def _check(where: str, words: Mapping[str, str], expected: Mapping[str, str]) -> None:
    """Refuse words that are missing, are unknown, or have other placeholders than expected ones."""
    if others := sorted(words.keys() ^ expected.keys()):
        raise ValueError(f"{where} {'lacks' if others[0] in expected else 'alone has'} {others[0]!r}")
    for key, text in words.items():
        has, needed = (sorted(set(re.findall(r"\{.*?\}", words_of))) for words_of in (text, expected[key]))
        if has != needed:
            raise ValueError(
                f"{where}: {key} has {', '.join(has) or 'no placeholder'}, expected {', '.join(needed) or 'none'}"
            )


@cache
def _tables() -> dict[str, Any]:
    """Tables by code; English with the words of the page that sets up a tablet, which are written there."""
    tables = parse_toml(TABLES.read_bytes())
    script = (PAGE / "settings.js").read_text(encoding="utf-8")
    match = re.search(r"^export const WORDS = (\{.*?^\});", script, re.DOTALL | re.MULTILINE)
    assert match is not None
    tables[ENGLISH]["words"] = json.loads(match[1]) | tables[ENGLISH]["words"]
    return tables
