"""Units: their factors, and where a header states one; `factor_of` converts or refuses each."""

import contextlib
import re
import tomllib
import unicodedata
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from foten.recording.recording import UNITS

G = 9.80665  # m/s², standard gravity
POUND_N = 0.45359237 * G  # the weight of a pound, whose mass is exact
CLOCK = "seconds of a clock"
"""The unit of times of a clock, which were made seconds whatever their header says."""
FULL_SCALE = "of full scale"
"""The unit of integer samples of sound, which needs a factor from the user."""

_LENGTHS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "nm": 1e-6, "in": 25.4, "ft": 304.8}

FACTORS: Mapping[str, Mapping[str, float]] = {
    "acceleration": {"m/s^2": 1.0, "g": G, "mg": G / 1000, "Gal": 0.01}
    | {f"{unit}/s^2": mm / 1000 for unit, mm in _LENGTHS_MM.items()},
    "speed": {f"{unit}/s": mm for unit, mm in _LENGTHS_MM.items()}
    | {"mm/min": 1 / 60, "m/min": 1000 / 60, "km/h": 1000 / 3.6},
    "position": _LENGTHS_MM,
    "force": {"N": 1.0, "cN": 1e-2, "mN": 1e-3, "daN": 10.0, "kN": 1e3}
    | {"gf": G / 1000, "kgf": G, "lbf": POUND_N, "ozf": POUND_N / 16, "dyn": 1e-5},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
}
"""Factors to the unit of `UNITS` (time: seconds), by quantity."""

_MASSES: Mapping[str, str] = {"g": "gf", "gram": "gf", "kg": "kgf", "lb": "lbf", "oz": "ozf"}
"""Units of mass, each with the force that a sensor of weight may mean by it."""

_RAW = frozenset(["V", "mV", "uV", "A", "mA", "uA", "V/V", "mV/V", "count", "LSB", "ADC", "bit", "digit", "%"])
"""Units of converters and amplifiers, which need a sensitivity."""

WORDS: Mapping[str, Mapping[str, str]] = tomllib.loads(
    Path(__file__).with_name("words.toml").read_text(encoding="utf-8")
)
"""Words of headers, axes and units, each with blanks between them."""

_UNITS = frozenset(unit for known in FACTORS.values() for unit in known) | set(_MASSES) | _RAW
_CALLED = {unit.lower(): unit for unit in _UNITS} | {
    word: unit for unit, words in WORDS["units"].items() for word in words.split()
}
"""What a word in small letters stands for; case counts only where M may be mega, not milli."""

_QUOTIENT = re.compile(
    r"(?P<over>[a-z'-]+)[/ .·*]\(?(?P<under>s|sec|second|seconds|min|minute|h|hr|hour)"
    r"(?P<power>\^?\(?-?[12]\)?| squared|/s|/sec|/second)?\)?",
    re.IGNORECASE,
)
_BRACKETS = re.compile(r"\s*(?P<open>[\[(])(?P<words>[^\[\]()]*)(?:[\])]|$)")
_AXIS = re.compile(r"(?P<name>.+?)(?P<axis>[_.](?:[xyz]|\d+))?")
_BEFORE_A_UNIT = re.compile(r"\s+in\s+|\s*[/,]\s*|[_\s]+")

_REMARKS = frozenset(["normal", "tangential", "lateral", "vertical", "horizontal", "filtered", "smoothed", *"xyz"])
"""Words in brackets that are no unit."""

_NAMES = frozenset(["in", "ft", "min", "h", "n", "v", "a", "s", "m", "g's", "gs", "count", "bit", "digit"])
"""Units that at the end of a name rather mean input, force-torque, minimum or normal, except for their own quantity."""


def quantity(channel: str) -> str:
    """Quantity that a channel measures: `force_x` → `force`."""
    return channel.split("_")[0]


def canonical(text: str) -> str:
    """Unit as `FACTORS` spells it: `m/s²`, `m s-2`, `m_s2`, `metres/second^2` → `m/s^2`; an unknown one as it is."""
    unit = unicodedata.normalize("NFKC", text).replace("−", "-").replace("μ", "u").replace("**", "^")
    unit = re.sub(r"(?:\b|_)per(?:\b|_)", "/", unit).replace("_", " ")
    unit = re.sub(r"\s*/\s*", "/", " ".join(unit.split()))
    unit = re.sub(r"^([a-z]+)(s\^?\(?-[12]\)?)$", r"\1 \2", unit)  # ms-2 has no blank
    quotient = _QUOTIENT.fullmatch(unit)
    if quotient:
        over, under = _word(quotient["over"]), _word(quotient["under"])
        power = quotient["power"] or ""
        rate = f"{over}/{under}{'^2' * ('2' in power or '/' in power or 'squared' in power)}"
        if rate in _UNITS:
            return rate
    return _word(unit)


def _word(text: str) -> str:
    small = text.lower()
    return text if small not in _CALLED or text in ("MN", "MV", "MA") else _CALLED[small]


def is_unit(text: str) -> bool:
    """Whether a word, in brackets or not, is a unit of some quantity or of a converter."""
    return canonical(text.strip(" []()")) in _UNITS


def split_header(header: str, kind: str) -> tuple[str, str]:
    """Header without its unit, and the unit as it is written: `Acc [g]`, `acc_g`, `Acc / g` → `Acc`, `g`.

    A word in brackets is a unit, but for a remark in parentheses; the end of a name where it is a unit of the quantity (`kind`).
    """
    name = _BRACKETS.sub("", header).strip()
    brackets = [_stated(match["open"], match["words"]) for match in _BRACKETS.finditer(header)]
    stated = [unit for unit in brackets if unit]
    if stated:
        return name.rstrip(" /,_"), next(filter(is_unit, stated), stated[-1])
    parts = _AXIS.fullmatch(name)
    if parts is None:
        return name, ""
    for before in _BEFORE_A_UNIT.finditer(parts["name"]):
        unit = parts["name"][before.end() :]
        if before.start() and _ends_a_name(unit, kind):
            return parts["name"][: before.start()] + (parts["axis"] or ""), unit
    return name, ""


def _stated(bracket: str, words: str) -> str:
    """Unit that brackets in a header state, or nothing of a remark."""
    words = words.strip()
    several = words.split()
    of_a_unit = any(is_unit(word) or word.lower() in ("unit", "units", "raw") for word in (words, *several))
    is_remark = bracket == "(" and len(several) > 1 and not of_a_unit
    return "" if is_remark or words.lower() in _REMARKS else words


def _ends_a_name(text: str, kind: str) -> bool:
    unit = canonical(text)
    if text.lower() in _NAMES:
        return text == unit and ((unit in FACTORS[kind] and unit not in ("in", "ft")) or text == "V")
    return unit in _UNITS and (len(text) > 1 or unit in FACTORS[kind] or (kind == "force" and unit in _MASSES))


def factor_of(channel: str, header: str, stated: str = "", by_user: str | None = None) -> tuple[float, str]:
    """Factor from a column to the unit of `UNITS`, and a sentence on it; ValueError for the unit of another quantity.

    Of a `channel` or `time`, the column's name, and the unit `stated` beside it in the file, in a row of units or as an
    attribute. `by_user`, before both, is a unit, `*FACTOR` or `LABEL*FACTOR`.
    """
    kind, target = quantity(channel), UNITS.get(channel, "s")
    known = FACTORS[kind]
    if stated == CLOCK:
        if kind != "time" or by_user is not None:
            raise ValueError(f"{channel}: column {header!r} holds times of a clock, which are seconds: no other unit")
        return 1.0, f"time was read as a clock's, in seconds from the first ({header})"
    in_header = split_header(header, kind)[1]
    if by_user is None and stated and in_header and canonical(stated) != canonical(in_header):
        both = f"is in {in_header} by its name and in {stated} by its unit"
        raise ValueError(f"{channel}: column {header!r} {both}; say which: --unit {channel}={in_header}")
    of_file = stated or in_header
    text = of_file if by_user is None else by_user
    if not text:
        return 1.0, ""
    label = canonical(text)
    if label in known:
        factor = known[label]
        if of_file and canonical(of_file) != label:
            return factor, f"{channel} was taken as {label}, where its file states {of_file}"
        return factor, "" if factor == 1 else f"{channel} was converted from {label} to {target}"
    if by_user is not None and "*" in text:
        return _sensitivity(channel, text, known, target)
    if label == FULL_SCALE:
        hint = f"say how many {target} full scale is, e.g. --unit {channel}=*50"
        raise ValueError(f"{channel}: the samples of {header} are fractions of full scale; {hint}")
    if kind == "force" and label in _MASSES:
        hint = f"that is a mass: if the sensor shows the weight on it, --unit {channel}={_MASSES[label]}"
    elif kind == "time":
        hint = f"for another, --unit {channel}=*FACTOR; or leave time out and give --rate"
    elif label in _RAW:
        hint = f"say how many {target} one {label} is, e.g. --unit {channel}={label}*4.9"
    else:
        hint = f"for a sensitivity write e.g. --unit {channel}=V*4.9 (4.9 {target} per volt)"
    place, otherwise = "", ""
    if by_user is None:
        place, otherwise = f" of column {header!r}", f"; if it is no unit, --unit {channel}={target}"
    raise ValueError(f"{channel}: unit {text!r}{place} is not one of {', '.join(known)}; {hint}{otherwise}")


def _sensitivity(channel: str, text: str, known: Mapping[str, float], target: str) -> tuple[float, str]:
    """Factor of `LABEL*FACTOR`, and a sentence."""
    label, _, number = text.rpartition("*")
    label, factor = canonical(label), float("nan")
    with contextlib.suppress(ValueError):
        factor = float(number)
    if not np.isfinite(factor) or factor == 0:
        raise ValueError(f"{channel}: unit {text!r}: {number!r} is not a factor, e.g. {channel}=V*4.9")
    if label in known and label != target:
        write = f"write {channel}={label}, or {channel}=*{known[label] * factor:g} to get {target}"
        raise ValueError(f"{channel}: {label} is a known unit and takes no factor; {write}")
    return factor, f"{channel} was multiplied by {factor:g} to get {target}" + f" from {label}" * bool(label)
