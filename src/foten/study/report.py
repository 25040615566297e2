"""The report of a study: one self-contained HTML page, the same as Markdown, figures, tidy tables and what their columns mean."""

from __future__ import annotations

import csv
import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from foten.atomic_write import atomic_write
from foten.study.analysis import Result, stars
from foten.study.pictures import bars, panels

MARK = "Simulated ratings: of a model of raters, and not of people."
DICTIONARY = (
    ("participant", "number of the participant", ""),
    ("trial", "in which order it was rated, from 1", ""),
    ("texture", "key of the texture", ""),
    ("method", "key of the method", ""),
    ("rating", "0 completely different … 100 completely the same", "points"),
    ("response_s", "from when the trial was shown to the answer", "s"),
    ("switches", "how often the hand went over between the real and the virtual surface", ""),
    ("corrected", "1 where a correction holds, and not the first answer", ""),
    ("simulated", "1 where a model of raters answered", ""),
    ("contact_s", "the pen on the virtual surface", "s"),
    ("speed_mm_s_p10 … p90", "percentiles of the speed while in contact", "mm/s"),
    ("force_n_p10 … p90", "percentiles of the force while in contact", "N"),
    ("block_p99_ms", "99 % of blocks were rendered within", "ms"),
    ("n_missed", "blocks that came late", ""),
    ("n_underruns", "times that the sound had nothing to play", ""),
    ("sha256", "of the texture file", ""),
    ("at", "when the answer was stored (UTC)", ""),
)
_MEASURED = (
    "contact_s",
    *(f"{name}_p{percent}" for name in ("speed_mm_s", "force_n") for percent in (10, 50, 90)),
    "block_p99_ms",
    "n_missed",
    "n_underruns",
)
LONG = (
    "participant",
    "trial",
    "texture",
    "method",
    "rating",
    "response_s",
    "switches",
    "corrected",
    "simulated",
    *_MEASURED,
)
STYLE = """:root { color-scheme: light dark; --ink: #1b1f24; --soft: #59636e; --page: #fff; --panel: #f5f6f8; --line: #d9dde2; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e7eb; --soft: #9aa4af; --page: #15181c; --panel: #1e2227;
  --line: #343a42; } }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 60rem; margin: 0 auto; padding: 2rem 1.5rem 4rem; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 1rem; } h2 { font-size: 1.3rem; margin: 2.6rem 0 0.8rem; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; } .scroll { overflow-x: auto; }
th, td { text-align: left; padding: 0.4rem 0.8rem 0.4rem 0; border-bottom: 1px solid var(--line); white-space: nowrap; }
thead th { border-bottom-width: 2px; font-size: 0.9rem; } figure { margin: 0; } svg { max-width: 100%; height: auto; }
.mark { padding: 0.7rem 1rem; border-radius: 8px; background: #b4481e; color: #fff; font-weight: 600; }
.note { padding: 0.7rem 1rem; border-left: 4px solid #d8a01a; background: var(--panel); margin: 0.6rem 0; } p { max-width: 75ch; }
"""


def write_report(result: Result, folder: Path) -> list[Path]:
    """Write report.html, report.md, results.json, ratings.csv (long), ratings-wide.csv, dictionary.csv, pairs.csv, and the
    figures as SVG and PNG; return their paths.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures = {"ratings": bars(result), "textures": panels(result)}
    written = []
    for name, figure in figures.items():
        for kind in ("svg", "png"):
            path = folder / f"{name}.{kind}"
            with atomic_write(path) as part:
                figure.savefig(part, format=kind, dpi=150)
            written.append(path)
    svgs = {name: (folder / f"{name}.svg").read_text(encoding="utf-8") for name in figures}
    texts = {
        "report.html": _html(result, svgs),
        "report.md": _markdown(result),
        "results.json": json.dumps(result.document, indent=1, allow_nan=False) + "\n",
    }
    for name, text in texts.items():
        with atomic_write(folder / name) as part:
            part.write_text(text, encoding="utf-8")
        written.append(folder / name)
    tables: dict[str, list[Sequence[Any]]] = {
        "ratings.csv": _long(result),
        "ratings-wide.csv": _wide(result),
        "pairs.csv": _pairs(result),
        "dictionary.csv": [("column", "meaning", "unit"), *DICTIONARY],
    }
    for name, rows in tables.items():
        with atomic_write(folder / name) as part, part.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)
        written.append(folder / name)
    return [folder / "report.html", *(path for path in written if path.name != "report.html")]


def _long(result: Result) -> list[Sequence[Any]]:
    rows: list[Sequence[Any]] = [(*LONG, "sha256", "at")]
    for row in result.rows:
        known = {**row["measured"], **row, "texture": row["texture_key"], "method": row["method_key"]}
        known |= {"corrected": int(row["corrected"])}
        rows.append([_cell(known.get(name)) for name in (*LONG, "sha256", "at")])
    return rows


def _wide(result: Result) -> list[Sequence[Any]]:
    """Return a row for each participant, as JASP and jamovi want repeated measures; a cell that lacks stays empty."""
    numbers = sorted({row["participant"] for row in result.rows})
    names = [f"{method}.{texture}" for method in result.methods for texture in result.textures]
    rows: list[Sequence[Any]] = [("participant", *(["simulated"] if result.simulated else []), *names)]
    for number, ratings in zip(numbers, result.ratings, strict=True):
        cells = ["" if value != value else f"{value:g}" for value in ratings.reshape(-1)]
        rows.append([number, *([1] if result.simulated else []), *cells])
    return rows


def _pairs(result: Result) -> list[Sequence[Any]]:
    names = ("difference", "t", "df", "p", "p_bonferroni", "p_holm", "dz", "d_av")
    rows: list[Sequence[Any]] = [("texture", "first", "second", *names, "ci95_low", "ci95_high", "simulated")]
    of = {"": result.document["pairs_overall"], **result.document["pairs_within_textures"]}
    for texture, tests in of.items():
        for one in tests:
            cells = [_cell(one[name]) for name in names]
            rows.append([texture, *one["pair"], *cells, *(_cell(end) for end in one["ci95"]), int(result.simulated)])
    return rows


def _cell(value: Any) -> Any:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else value


def _tables(result: Result) -> list[tuple[str, list[Sequence[str]]]]:
    """Return what people read: title and rows, the first of which is the head."""
    document = result.document
    means: list[Sequence[str]] = [("method", "mean", "SD", "95 % CI of the mean")]
    for one in (one for one in document["means"] if one["texture"] is None):
        from scipy import stats

        half = stats.t.ppf(0.975, one["n"] - 1) * one["sd"] / one["n"] ** 0.5
        means.append(
            (
                one["method"],
                f"{one['mean']:.2f}",
                f"{one['sd']:.2f}",
                f"{one['mean'] - half:.2f} to {one['mean'] + half:.2f}",
            )
        )
    anova: list[Sequence[str]] = [
        ("effect", "F", "df", "ε", "p (Greenhouse–Geisser)", "η² partial", "η² generalised", "Mauchly p")
    ]
    for name, effects in (("method, averaged", document["anova_one_way"]), ("", document["anova_two_way"])):
        for one in effects:
            df = f"{one['df'][0]:.0f}, {one['df'][1]:.0f}"
            numbers = [
                _short(one[key]) for key in ("epsilon", "p_corrected", "partial_eta2", "generalised_eta2", "mauchly_p")
            ]
            anova.append((name or one["name"], _short(one["f"]), df, *numbers))
    pairs: list[Sequence[str]] = [("pair", "difference", "95 % CI", "t", "p Bonferroni", "p Holm", "dz")]
    for one in document["pairs_overall"]:
        ends = " to ".join(_short(end) for end in one["ci95"])
        numbers = [_short(one[key]) for key in ("t", "p_bonferroni", "p_holm", "dz")]
        pairs.append((f"{one['pair'][0]} − {one['pair'][1]}", f"{one['difference']:.2f}", ends, *numbers))
    found = [("Ratings", means), ("Analyses of variance", anova), ("Pairs, averaged across textures", pairs)]
    model = document["mixed_model"]
    if model is not None:
        rows: list[Sequence[str]] = [("effect", "F", "df", "p")]
        rows += [
            (term["name"], _short(term["f"]), f"{term['df'][0]:.0f}, {term['df'][1]:.0f}", _short(term["p"]))
            for term in model["terms"]
        ]
        found.append((f"Linear mixed model of all {model['n_ratings']} ratings", rows))
    return found


def _short(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2e}" if 0 < abs(value) < 5e-4 else f"{value:.3f}" if abs(value) < 10 else f"{value:.2f}"


def _html(result: Result, svgs: dict[str, str]) -> str:
    esc = html.escape
    parts = [f"<h1>{esc(result.title)}</h1>"]
    if result.simulated:
        parts.append(f'<p class="mark">{esc(MARK)}</p>')
    parts += [
        f'<p class="note">{esc(one)}</p>'
        for one in result.cautions
        if not (result.simulated and "model of raters" in one)
    ]
    parts.append(f"<h2>Ratings by method and texture</h2><figure>{_inline(svgs['ratings'])}</figure>")
    parts.append("<h2>In words</h2>")
    parts += [f"<p>{esc(sentence)}</p>" for sentence in result.sentences]
    for title, rows in _tables(result):
        parts.append(f"<h2>{esc(title)}</h2>{_html_table(rows)}")
    parts.append(f"<h2>Each texture</h2><figure>{_inline(svgs['textures'])}</figure>")
    parts.append(f"<h2>Columns of ratings.csv</h2>{_html_table([('column', 'meaning', 'unit'), *DICTIONARY])}")
    body = "\n".join(parts)
    head = (
        f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{esc(result.title)}</title>'
    )
    whole = f'<html lang="en"><head>{head}<style>{STYLE}</style></head>\n<body><main>\n{body}\n</main></body></html>'
    return f"<!doctype html>\n{whole}\n"


def _inline(svg: str) -> str:
    return svg[svg.index("<svg") :]


def _html_table(rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in rows[0])
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows[1:])
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _markdown(result: Result) -> str:
    parts = [f"# {result.title}"]
    if result.simulated:
        parts.append(f"**{MARK}**")
    parts += [f"> {one}" for one in result.cautions]
    parts += ["![Ratings by method and texture](ratings.png)", *result.sentences]
    for title, rows in _tables(result):
        parts += [
            f"## {title}",
            "\n".join(["| " + " | ".join(row) + " |" for row in (rows[0], ["---"] * len(rows[0]), *rows[1:])]),
        ]
    within: list[str] = []
    for texture, tests in result.document["pairs_within_textures"].items():
        marked = [
            f"{one['pair'][0]} − {one['pair'][1]} {one['difference']:+.1f}{stars(one['p_holm'])}" for one in tests
        ]
        within.append(f"- {texture}: {', '.join(marked)}")
    parts += ["## Within textures (Holm)", "\n".join(within), "![Each texture](textures.png)"]
    return "\n\n".join(parts) + "\n"
