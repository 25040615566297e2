"""`foten doctor`."""

from __future__ import annotations

from dataclasses import asdict

import typer

from foten.cli.console import JsonOption, print_json


def doctor(as_json: JsonOption = False) -> None:
    """Look at what this machine has for rendering, and say what is missing."""
    from foten.runtime import doctor as examination

    checks = examination.checks()
    if as_json:
        print_json([asdict(check) for check in checks])
    else:
        for check in checks:
            mark = {True: "✓", False: "✗", None: " "}[check.fine]
            print(f"{mark} {check.name:14s}{check.result}")
    if any(check.fine is False for check in checks):
        raise typer.Exit(1)
