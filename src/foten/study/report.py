"""The report of a study: one self-contained HTML page, the same as Markdown, figures, tidy tables and what their columns mean."""

from __future__ import annotations

import csv
import html
import json
import math
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foten.atomic_write import atomic_write
from foten.study.analysis import Result, stars
from foten.study.rating_figures import bars, panels

MOST_ROWS = 12  # of a table that people read
MOST_NAMED = 8  # different answers to a question that the report names
CI = "95 % CI, not adjusted"
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
    ("software", "version of foten that stored the answer", ""),
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
    "software",
    "sha256",
    "at",
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
    """Write report.html, report.md, results.json, ratings.csv (long), ratings-wide.csv, dictionary.csv, pairs.csv, answers.csv,
    participants.csv, and the figures as SVG and PNG; return their paths.
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
        "answers.csv": _answers(result),
        "participants.csv": _participants(result),
        "dictionary.csv": [("column", "meaning", "unit"), *DICTIONARY],
    }
    for name, rows in tables.items():
        with atomic_write(folder / name) as part, part.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)
        written.append(folder / name)
    return [folder / "report.html", *(path for path in written if path.name != "report.html")]


def _long(result: Result) -> list[Sequence[Any]]:
    rows: list[Sequence[Any]] = [LONG]
    for row in result.rows:
        known = {**row["measured"], **row, "texture": row["texture_key"], "method": row["method_key"]}
        known |= {"corrected": int(row["corrected"])}
        rows.append([_cell(known.get(name)) for name in LONG])
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


def _answers(result: Result) -> list[Sequence[Any]]:
    names = ("participant", "question", "answer", "at")
    rows: list[Sequence[Any]] = [(*names, "simulated")]
    rows += [[*(one[name] for name in names), int(result.simulated)] for one in result.answers]
    return rows


def _participants(result: Result) -> list[Sequence[Any]]:
    """Return what participants said of themselves, in sum: a row for a question that has numbers, else one for each answer."""
    rows: list[Sequence[Any]] = [("question", "n", "mean", "sd", "answer", "count", "simulated")]
    for question, said in _by_question(result).items():
        numbers = _numbers(said)
        if numbers is not None:
            summary = [_cell(statistics.fmean(numbers)), _cell(_sd(numbers)), "", ""]
            rows.append([question, len(said), *summary, int(result.simulated)])
            continue
        for answer, count in Counter(said).most_common():
            rows.append([question, len(said), "", "", answer, count, int(result.simulated)])
    return rows


def _participants_paragraph(result: Result) -> str:
    """Return the same as a line to read; empty where nothing was asked."""
    parts = []
    for question, said in _by_question(result).items():
        numbers, counts = _numbers(said), Counter(said)
        if numbers is not None:
            sd = _sd(numbers)
            spread = "" if sd is None else f" ± {sd:.1f}"
            parts.append(f"{question} {statistics.fmean(numbers):.1f}{spread} (n = {len(said)})")
        elif len(counts) <= MOST_NAMED:
            parts.append(f"{question}: {', '.join(f'{answer} {count}' for answer, count in counts.most_common())}")
        else:
            parts.append(f"{question}: {len(counts)} different answers, in participants.csv")
    return f"{'; '.join(parts)}." if parts else ""


def _by_question(result: Result) -> dict[str, list[str]]:
    """Return the answers to the private questions; a question that was passed over has none."""
    said: dict[str, list[str]] = {}
    for one in result.abouts:
        if answer := " ".join(str(one["answer"]).split()):
            said.setdefault(one["question"], []).append(answer)
    return said


def _numbers(said: Sequence[str]) -> list[float] | None:
    """Return answers as numbers, or None where one is not."""
    try:
        numbers = [float(one) for one in said]
    except ValueError:
        return None
    return numbers if all(math.isfinite(one) for one in numbers) else None


def _sd(numbers: Sequence[float]) -> float | None:
    return statistics.stdev(numbers) if len(numbers) > 1 else None


def _cell(value: Any) -> Any:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else value


@dataclass(frozen=True)
class _Table:
    """What people read: rows, the first of which is the head."""

    title: str
    rows: list[Sequence[str]]
    note: str = ""
    folded: bool = False  # shown when asked for, where a page can


def _tables(result: Result) -> list[_Table]:
    document = result.document
    several = len(result.textures) > 1
    across = ", averaged across textures" if several else ""
    means: list[Sequence[str]] = [("method", "mean", "SD", "95 % CI of the mean, not adjusted")]
    for one in (one for one in document["means"] if one["texture"] is None):
        from scipy import stats

        half = stats.t.ppf(0.975, one["n"] - 1) * one["sd"] / one["n"] ** 0.5
        ends = f"{one['mean'] - half:.2f} to {one['mean'] + half:.2f}"
        means.append((one["method"], f"{one['mean']:.2f}", f"{one['sd']:.2f}", ends))
    anova: list[Sequence[str]] = [
        ("effect", "F", "df", "ε", "p (Greenhouse–Geisser)", "η² partial", "η² generalised", "Mauchly p")
    ]
    averaged = "method, averaged" if several else "method"
    for name, effects in ((averaged, document["anova_one_way"]), ("", document["anova_two_way"])):
        for one in effects:
            df = f"{one['df'][0]:.0f}, {one['df'][1]:.0f}"
            numbers = [
                _short(one[key]) for key in ("epsilon", "p_corrected", "partial_eta2", "generalised_eta2", "mauchly_p")
            ]
            anova.append((name or one["name"], _short(one["f"]), df, *numbers))
    tests, note = _lowest(document["pairs_overall"], "pairs.csv")
    pairs: list[Sequence[str]] = [("pair", "difference", CI, "t", "p Bonferroni", "p Holm", "dz")]
    for one in tests:
        numbers = [_short(one[key]) for key in ("t", "p_bonferroni", "p_holm", "dz")]
        pairs.append((_pair(one), f"{one['difference']:.2f}", _interval(one), *numbers))
    found = [_Table("Ratings", means), _Table("Analyses of variance", anova), _Table(f"Pairs{across}", pairs, note)]
    if several:  # else they are those above
        found += _within(document["pairs_within_textures"])
    tests, note = _lowest(document["wilcoxon"], "results.json")
    signed: list[Sequence[str]] = [("pair", "W", "p", "p Holm", "rank-biserial")]
    for one in tests:
        signed.append((_pair(one), *(_short(one[key]) for key in ("w", "p", "p_holm", "rank_biserial"))))
    found.append(_Table(f"Wilcoxon's signed-rank tests{across}", signed, note))
    model = document["mixed_model"]
    if model is not None:
        rows: list[Sequence[str]] = [("effect", "F", "df", "p")]
        rows += [
            (term["name"], _short(term["f"]), f"{term['df'][0]:.0f}, {term['df'][1]:.0f}", _short(term["p"]))
            for term in model["terms"]
        ]
        found.append(_Table(f"Linear mixed model of all {model['n_ratings']} ratings", rows))
    return [*found, *_agreement(document["reliability"])]


def _within(tests_of: dict[str, list[dict[str, Any]]]) -> list[_Table]:
    """Return the tests within textures: one table, or one for each texture where that has too many rows."""
    head = ("pair", "difference", CI, "p Bonferroni", "p Holm", "dz")

    def row(one: dict[str, Any]) -> tuple[str, ...]:
        numbers = [_short(one[key]) for key in ("p_bonferroni", "p_holm", "dz")]
        return _pair(one), f"{one['difference']:.2f}", _interval(one), *numbers

    if sum(len(tests) for tests in tests_of.values()) <= MOST_ROWS:
        rows = [(texture, *row(one)) for texture, tests in tests_of.items() for one in tests]
        return [_Table("Tests within textures", [("texture", *head), *rows])]
    found = []
    for texture, tests in tests_of.items():
        shown, note = _lowest(tests, "pairs.csv")
        found.append(_Table(f"Tests within {texture}", [head, *(row(one) for one in shown)], note, folded=True))
    return found


def _agreement(reliability: dict[str, Any]) -> list[_Table]:
    """Return how far participants agree, and those who agree least with the others."""
    icc: list[Sequence[str]] = [("intraclass correlation", "value")]
    icc += [("of one rater, ICC(2,1)", _short(reliability["icc_single"]))]
    icc += [("of the mean of all, ICC(2,k)", _short(reliability["icc_mean"]))]
    least_first = sorted(reliability["with_others"].items(), key=lambda one: -2.0 if one[1] is None else one[1])
    many = len(least_first)
    note = f"The lowest {MOST_ROWS} of {many}; results.json has all." if many > MOST_ROWS else ""
    each = [(number, _short(r)) for number, r in least_first[:MOST_ROWS]]
    return [
        _Table("Reliability", icc),
        _Table("Each participant's correlation with the others", [("participant", "correlation"), *each], note),
    ]


def _lowest(tests: list[dict[str, Any]], file: str) -> tuple[list[dict[str, Any]], str]:
    """Return tests that a table can show, in their order, and what is left out."""
    if len(tests) <= MOST_ROWS:
        return tests, ""
    limit = sorted(range(len(tests)), key=lambda k: 2.0 if tests[k]["p"] is None else tests[k]["p"])[:MOST_ROWS]
    return [tests[k] for k in sorted(limit)], f"The {MOST_ROWS} lowest p of {len(tests)} pairs; {file} has all."


def _pair(one: dict[str, Any]) -> str:
    return f"{one['pair'][0]} − {one['pair'][1]}"


def _interval(one: dict[str, Any]) -> str:
    return " to ".join(_short(end) for end in one["ci95"])


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
    if paragraph := _participants_paragraph(result):
        parts.append(f"<h2>Participants</h2><p>{esc(paragraph)}</p>")
    tables = _tables(result)
    for table in tables:
        if table.folded and table == next(one for one in tables if one.folded):
            parts.append("<h2>Tests within textures</h2>")
        parts.append(_html_of(table))
    parts.append(f"<h2>Each texture</h2><figure>{_inline(svgs['textures'])}</figure>")
    parts.append("<p>ratings.csv beside this page holds every rating; dictionary.csv says what its columns mean.</p>")
    body = "\n".join(parts)
    head = (
        f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{esc(result.title)}</title>'
    )
    whole = f'<html lang="en"><head>{head}<style>{STYLE}</style></head>\n<body><main>\n{body}\n</main></body></html>'
    return f"<!doctype html>\n{whole}\n"


def _inline(svg: str) -> str:
    return svg[svg.index("<svg") :]


def _html_of(table: _Table) -> str:
    title, note = html.escape(table.title), f"<p>{html.escape(table.note)}</p>" if table.note else ""
    if table.folded:
        return f"<details><summary>{title}</summary>{note}{_html_table(table.rows)}</details>"
    return f"<h2>{title}</h2>{note}{_html_table(table.rows)}"


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
    if paragraph := _participants_paragraph(result):
        parts += ["## Participants", html.escape(paragraph, quote=False)]  # Markdown lets HTML through
    for table in _tables(result):
        lines = (table.rows[0], ["---"] * len(table.rows[0]), *table.rows[1:])
        parts += [f"## {table.title}", *([table.note] if table.note else [])]
        parts.append("\n".join("| " + " | ".join(line) + " |" for line in lines))
    within: list[str] = []
    for texture, tests in result.document["pairs_within_textures"].items():
        marked = [
            f"{one['pair'][0]} − {one['pair'][1]} {one['difference']:+.1f}{stars(one['p_holm'])}" for one in tests
        ]
        within.append(f"- {texture}: {', '.join(marked)}")
    parts += ["## Within textures (Holm)", "\n".join(within), "![Each texture](textures.png)"]
    return "\n\n".join(parts) + "\n"
