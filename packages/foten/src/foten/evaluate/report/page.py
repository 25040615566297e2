"""The report as one HTML page, which needs nothing beside it."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from foten import __version__
from foten.atomic_write import atomic_write
from foten.evaluate.evaluate import Judgement
from foten.evaluate.report import plots, signals
from foten.evaluate.report.rows import free_run_table, one_step_table, waveform_error
from foten.evaluate.report.signals import LABELS, shown_blocks, shown_run
from foten.evaluate.report.verdict import Finding, cautions, headline, reason, verdict
from foten.models.texture_file import Texture
from foten.reporting.figure import inline_svg
from foten.reporting.table import minus
from foten.untrusted import LONGEST_TEXT, shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKS = {"good": "✓", "even": "≈", "bad": "✗", "unknown": "–"}


def write_report(judgement: Judgement, texture: Texture, directory: Path) -> Path:
    """Write `report.html`, which loads nothing, and `evaluation.json` into a directory, and return the path of the former."""
    directory.mkdir(parents=True, exist_ok=True)
    document = json.dumps({"foten": __version__, **judgement.document}, indent=1, allow_nan=False)
    for name, text in (("evaluation.json", f"{document}\n"), ("report.html", page(judgement, texture))):
        with atomic_write(directory / name) as part:
            part.write_text(text, encoding="utf-8", newline="\n")
    return directory / "report.html"


def page(judgement: Judgement, texture: Texture) -> str:
    """HTML of the report."""
    document = judgement.document
    findings = verdict(document)
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in cautions(document))
    raw = {"All figures (JSON)": document, "The texture's card (JSON)": texture.card}
    whole = _part(
        "page",
        name=html.escape(shown(document["texture"], LONGEST_TEXT) or "unnamed texture"),
        style=Path(__file__).with_name("style.css").read_text(encoding="utf-8"),
        headline=html.escape(shown(headline(judgement))),
        cards="".join(map(_card, findings)),
        sentences=" ".join(html.escape(finding.sentence) for finding in findings),
        cautions=f'<ul class="cautions">{notes}</ul>' if notes else "",
        sound=_sound(judgement),
        sd=f"{document['sd_m_s2']:.4g} {document['unit']}",
        first_scored=document["first_scored"],
        one_step=one_step_table(document).html("a"),
        excitation=_excitation(document["one_step"]),
        free_run=free_run_table(document).html("b"),
        waveform_error=waveform_error(document),
        figures=_figures(judgement, texture),
        about=_about(document, texture),
        raw="".join(_details(title, dict(value)) for title, value in raw.items()),
    )
    return f"{whole}\n"


def _part(name: str, /, **texts: Any) -> str:
    """Part of `page.html` with texts, already escaped, in their places."""
    parts = Path(__file__).with_name("page.html").read_text(encoding="utf-8")
    _, _, part = parts.partition(f"<!-- {name} -->\n")
    return Template(part.partition("<!-- ")[0].strip()).substitute(texts)


def _card(finding: Finding) -> str:
    return (
        f'<div class="card {finding.tone}"><h3>{finding.title} <span class="mark">{_MARKS[finding.tone]}</span></h3>'
        f"<b>{html.escape(finding.figure)}</b><small>{html.escape(finding.beside)}</small></div>"
    )


def _details(title: str, value: Mapping[str, Any]) -> str:
    raw = html.escape(json.dumps(value, indent=1, ensure_ascii=False))
    return f"<details><summary>{title}</summary><pre>{raw}</pre></details>"


def _about(document: Mapping[str, Any], texture: Texture) -> str:
    takes = texture.card.get("takes")
    card, block_ms = texture.card, 1000 * document["block"] / document["rate_hz"]
    facts = {
        "model": document["model"],
        "rate": f"{document['rate_hz']:g} Hz",
        "judged": f"{document['n_blocks']} blocks of {block_ms:g} ms",
        "split": f"{document['split']} {(document['split_sha256'] or '')[:10]}".rstrip(),
        **({"takes": f"{len(takes)}, {sum(take['seconds'] for take in takes):g} s"} if takes else {}),
        "seed": document["seed"],
        "recorded sd": f"{document['sd_m_s2']:.4g} {document['unit']}",
        "trained range": texture.trained_range_in_words(),
        "above it": texture.extrapolation_in_words(),
        "tool": card["tool"] or "not stated",
        "sensors": card["sensors"] or "not stated",
        "notes": card["notes"] or "none",
        **({"made": texture.evidence} if texture.evidence else {}),
        "credit": texture.credit or "not stated",
        "texture file": document["texture_sha256"][:10],
        "recording": document["recording_sha256"][:10],
    }
    shown_facts = {key: html.escape(shown(str(value))) for key, value in facts.items()}
    return "".join(f"<div><dt>{key}</dt><dd>{value}</dd></div>" for key, value in shown_facts.items())


def _sound(judgement: Judgement) -> str:
    name = shown_run(judgement)
    if name is None:
        return ""
    recorded, synthesized, full_scale = signals.sounds(judgement, name)
    labelled = {"recorded": recorded, f"synthesized ({LABELS[name]})": synthesized}
    encoded = {label: base64.b64encode(data).decode("ascii") for label, data in labelled.items()}
    players = "".join(_part("player", label=label, data=data) for label, data in encoded.items())
    seconds = f"{(len(recorded) - signals.WAV_HEADER) / 2 / signals.AUDIO_HZ:.1f}"
    return _part("sound", players=players, seconds=seconds, full_scale=f"{full_scale:.3g} {judgement.document['unit']}")


def _excitation(one_step: Mapping[str, Any]) -> str:
    """How well the excitation fits the one-step errors."""
    if one_step.get("nll") is None:
        return ""
    half, most = (f"{100 * one_step[f'coverage_{share}']:.0f}" for share in (50, 90))
    spread, nll = f"{one_step['standardised_sd']:.2f}", minus(f"{one_step['nll']:.3f}")
    return _part("excitation", half=half, most=most, spread=spread, nll=nll)


def _figures(judgement: Judgement, texture: Texture) -> str:
    if shown_run(judgement) is None:
        return _part("no-figures", why=html.escape(reason(judgement.document, "free_run")))
    n_shown, n = len(shown_blocks(judgement)), len(judgement.blocks)
    some = "" if n_shown == n else f" {n_shown} of the {n} blocks, spread evenly."
    both = {"free_run", "free_run_ar"} <= judgement.synthesized.keys()
    words = {
        "n_waveform": signals.N_WAVEFORM,
        "block": judgement.blocks[signals.typical_block(judgement)],
        "same_noise": " AR(20) is driven by the same noise." * both,
        "beyond": texture.extrapolation_in_words(),
        "some": some,
    }
    figures = {
        "waveform": plots.waveform(judgement),
        "spectrum": plots.spectrum(judgement),
        "bands": plots.bands(judgement),
        "conditions": plots.conditions(judgement, texture),
        "reach": plots.reach(judgement, texture),
        "time": plots.over_time(judgement),
    }
    return _part("figures", **{name: _figure(name, figure, words) for name, figure in figures.items()})


def _figure(name: str, figure: Figure | None, words: Mapping[str, Any]) -> str:
    if figure is None:
        return ""
    described = _part(name, **words)
    title, _, caption = described.partition(". ")
    return _part(
        "figure", name=name, title=title, svg=inline_svg(figure, name, described), caption=html.escape(caption)
    )
