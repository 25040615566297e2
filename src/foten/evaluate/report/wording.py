"""Words and numbers that verdict and tables share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def reason(document: Mapping[str, Any], *keys: str) -> str:
    """Return the first reason that a document gives under some keys."""
    return next((str(document["reasons"][key]) for key in keys if key in document["reasons"]), "not known")


def ar_name(best: Mapping[str, Any]) -> str:
    """Return the name of the best linear predictor: its order, and whether it is scheduled."""
    return f"AR({best['order']})" + (" following speed and force" if best["scheduled"] else "")


def minus(text: str) -> str:
    """Return a number's text with a true minus."""
    return text.replace("-", "−")


def signed(value: float, digits: int) -> str:
    """Return a number with its sign, a true minus, and no sign where it rounds to zero."""
    text = f"{value:+.{digits}f}"
    return minus(text) if float(text) else f"{0:.{digits}f}"
