"""The report as one HTML page, which needs nothing beside it."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foten import __version__
from foten.atomic_write import atomic_write
from foten.evaluate.evaluate import Judgement
from foten.evaluate.report import plots, signals
from foten.evaluate.report.rows import free_run_section, one_step_section
from foten.evaluate.report.signals import LABELS, shown_blocks, shown_run
from foten.evaluate.report.verdict import cautions, headline, reason, verdict
from foten.models.texture_file import Texture
from foten.reporting.figure import inline_svg
from foten.untrusted import LONGEST_TEXT, shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKS = {"good": "✓", "even": "≈", "bad": "✗", "unknown": "–"}


def write_report(judgement: Judgement, texture: Texture, directory: Path) -> Path:
    """Write `report.html` and `evaluation.json` into a directory, made where there is none, and return the path of the former.

    The page loads nothing and has no scripts. The same judgement gives the same bytes.
    """
    directory.mkdir(parents=True, exist_ok=True)
    document = json.dumps({"foten": __version__, **judgement.document}, indent=1, allow_nan=False)
    for name, text in (("evaluation.json", f"{document}\n"), ("report.html", page(judgement, texture))):
        with atomic_write(directory / name) as part:
            part.write_text(text, encoding="utf-8", newline="\n")
    return directory / "report.html"


def page(judgement: Judgement, texture: Texture) -> str:
    """HTML of the report."""
    document = judgement.document
    name = shown(document["texture"], LONGEST_TEXT) or "unnamed texture"
    sections = [
        _header(judgement, name),
        _verdict_section(document),
        _sound_section(judgement),
        one_step_section(document),
        free_run_section(document),
        _figures_section(judgement, texture),
        _about_section(document, texture),
        _raw_section(document, texture),
    ]
    style = Path(__file__).with_name("style.css").read_text(encoding="utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{html.escape(name)} – foten evaluate</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + "\n</main>\n</body>\n</html>\n"
    )


def _header(judgement: Judgement, name: str) -> str:
    words = html.escape(shown(headline(judgement)))
    return (
        f"<header><p class=kicker>foten evaluate</p><h1>{html.escape(name)}</h1><p class=headline>{words}</p></header>"
    )


def _about_section(document: Mapping[str, Any], texture: Texture) -> str:
    takes = texture.card.get("takes")
    card, block_ms = texture.card, 1000 * document["block"] / document["rate_hz"]
    split = f"{document['split']} {(document['split_sha256'] or '')[:10]}".rstrip()
    facts = {
        "model": document["model"],
        "rate": f"{document['rate_hz']:g} Hz",
        "judged": f"{document['n_blocks']} blocks of {block_ms:g} ms",
        "split": split,
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
    items = "".join(
        f"<div><dt>{key}</dt><dd>{html.escape(shown(str(value)))}</dd></div>" for key, value in facts.items()
    )
    return f'<section id="about"><h2>About</h2><dl>{items}</dl></section>'


def _verdict_section(document: Mapping[str, Any]) -> str:
    findings = verdict(document)
    cards = "".join(
        f'<div class="card {f.tone}"><h3>{f.title} <span class="mark">{_MARKS[f.tone]}</span></h3>'
        f"<b>{html.escape(f.figure)}</b><small>{html.escape(f.beside)}</small></div>"
        for f in findings
    )
    sentences = " ".join(html.escape(f.sentence) for f in findings)
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in cautions(document))
    listed = f'<ul class="cautions">{notes}</ul>' if notes else ""
    return f'<section id="verdict"><div class="cards">{cards}</div><p>{sentences}</p>{listed}</section>'


def _sound_section(judgement: Judgement) -> str:
    name = shown_run(judgement)
    if name is None:
        return ""
    recorded, synthesized, full_scale = signals.sounds(judgement, name)
    labelled = {"recorded": recorded, f"synthesized ({LABELS[name]})": synthesized}
    players = "".join(
        f'<figure><figcaption>{label}</figcaption><audio controls loop preload="metadata" '
        f'src="data:audio/wav;base64,{base64.b64encode(data).decode("ascii")}"></audio></figure>'
        for label, data in labelled.items()
    )
    seconds = (len(recorded) - signals.WAV_HEADER) / 2 / signals.AUDIO_HZ
    return (
        f'<section id="sound"><h2>Listen</h2><div class="pair">{players}</div>'
        f'<p class="notes">{seconds:.1f} s of the judged blocks, joined, in a loop; both at the same gain: full scale is '
        f"{full_scale:.3g} {judgement.document['unit']}. "
        "A small loudspeaker leaves out the low part: use headphones.</p></section>"
    )


def _figures_section(judgement: Judgement, texture: Texture) -> str:
    if shown_run(judgement) is None:
        why = html.escape(reason(judgement.document, "free_run"))
        return f'<section id="figures"><h2>Figures</h2><p>None: {why}.</p></section>'
    shown, n = len(shown_blocks(judgement)), len(judgement.blocks)
    some = "" if shown == n else f" {shown} of the {n} blocks, spread evenly."
    both = {"free_run", "free_run_ar"} <= judgement.synthesized.keys()
    same = " AR(20) is driven by the same noise." if both else ""
    block = judgement.blocks[signals.typical_block(judgement)]
    waveform = _figure(
        *("waveform", plots.waveform(judgement), "Waveform"),
        f"The first {signals.N_WAVEFORM} scored samples of block {block}, the one of median level. "
        f"A free run is another realisation: its character should match, its samples cannot.{same}",
    )
    spectrum = _figure(
        *("spectrum", plots.spectrum(judgement), "Power spectral density"),
        "Pooled over the scored samples of all judged blocks and all seeds: the spectra that the log-spectral distance is "
        "measured on, where they are not shaded.",
    )
    bands = _figure(
        *("bands", plots.bands(judgement), "Error by band"),
        "Energy against the recorded, in bands equal in log frequency; above 0 is too much.",
    )
    conditions = _figure(
        *("conditions", plots.conditions(judgement, texture), "Where it is right"),
        "Each judged block at its mean speed and force; red is too loud, blue too soft.",
    )
    reach = _figure(
        *("reach", plots.reach(judgement, texture), "Where measured ends"),
        "Level under a steady hand over speed and over force: shaded what was recorded, dashed what follows beyond. "
        f"Above it {texture.extrapolation_in_words()}.",
    )
    over_time = _figure(
        *("time", plots.over_time(judgement), "Over time"),
        "Spectrograms of the first seed on one colour scale, level in frames of 40 ms (band: lowest to highest seed), speed "
        f"and force, on one time axis; lines mark block borders.{some}",
    )
    return (
        f'<section id="figures"><h2>Figures</h2>{waveform}{spectrum}<div class="pair">{bands}{conditions}</div>'
        f"{reach}{over_time}</section>"
    )


def _figure(name: str, figure: Figure | None, title: str, caption: str) -> str:
    if figure is None:
        return ""
    return (
        f'<figure id="figure-{name}"><h3>{title}</h3>{inline_svg(figure, name, f"{title}. {caption}")}'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def _raw_section(document: Mapping[str, Any], texture: Texture) -> str:
    blocks = ""
    for title, value in {"All figures (JSON)": document, "The texture's card (JSON)": texture.card}.items():
        raw = html.escape(json.dumps(dict(value), indent=1, ensure_ascii=False))
        blocks += f"<details><summary>{title}</summary><pre>{raw}</pre></details>"
    return f'<section id="raw"><h2>Raw</h2>{blocks}</section>'
