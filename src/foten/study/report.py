"""The report of a study: one self-contained HTML page, the same as Markdown, figures, tidy tables and what their columns mean."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from foten.atomic_write import atomic_write
from foten.reporting.figure import inline_svg, write_figure
from foten.reporting.table import Table
from foten.study.analysis import Result
from foten.study.rating_figures import bars, panels

MAX_ROWS = 12  # of a table that people read; the rest is CSV
CI = "95 % CI, not adjusted"
# Keys of results.json in its tables, and their headings.
OF_MEANS = {"method": "method", "mean": "mean", "sd": "SD", "ci95": "95 % CI of the mean, not adjusted"}
OF_PAIRS = {"pair": "pair", "difference": "difference", "ci95": CI, "t": "t"}
OF_PAIRS |= {"p_bonferroni": "p Bonferroni", "p_holm": "p Holm", "dz": "dz"}
OF_RANKS = {"pair": "pair", "w": "W", "p": "p", "p_holm": "p Holm", "rank_biserial": "rank-biserial"}
OF_VARIANCE = {"name": "effect", "f": "F", "df": "df", "epsilon": "ε", "p_corrected": "p (Greenhouse–Geisser)"}
OF_VARIANCE |= {"partial_eta2": "η² partial", "generalised_eta2": "η² generalised", "mauchly_p": "Mauchly p"}
OF_MIXED = {"name": "effect", "f": "F", "df": "df", "p": "p"}
MARK = "Simulated ratings: of a model of raters, and not of people."
FIGURES = {
    "ratings": "Mean ratings of each method on each texture",
    "textures": "Ratings of each participant, a panel for each texture",
}
WITHIN = "Tests within textures"
SUMMARY = ["question", "n", "mean", "sd", "answer", "count"]  # of what participants say of themselves
STYLE = Path(__file__).with_name("report.css")
DICTIONARY = (  # columns of ratings.csv, meaning, unit
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
    *((f"speed_mm_s_p{p}", f"{p}th percentile of the speed while in contact", "mm/s") for p in (10, 50, 90)),
    *((f"force_n_p{p}", f"{p}th percentile of the force while in contact", "N") for p in (10, 50, 90)),
    ("block_p99_ms", "99 % of blocks were rendered within", "ms"),
    ("n_missed", "blocks that came late", ""),
    ("n_underruns", "times that the sound had nothing to play", ""),
    ("software", "version of foten that stored the answer", ""),
    ("sha256", "of the texture file", ""),
    ("at", "when the answer was stored (UTC)", ""),
)


def write_report(result: Result, folder: Path) -> list[Path]:
    """Write report.html, report.md, results.json, ratings.csv (long), ratings-wide.csv, dictionary.csv, pairs.csv, answers.csv,
    participants.csv, and the figures as PDF and PNG; return their paths.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures = {"ratings": bars(result), "textures": panels(result)}
    pictures = [folder / f"{name}.{form}" for name in figures for form in ("png", "pdf")]
    for path in pictures:
        write_figure(figures[path.stem], path, dpi=150)
    svgs = {name: inline_svg(figure, name, FIGURES[name]) for name, figure in figures.items()}
    texts = {
        "report.html": _html(result, svgs),
        "report.md": _markdown(result),
        "results.json": json.dumps(result.document, indent=1, allow_nan=False) + "\n",
    }
    for name, frame in _frames(result).items():
        texts[name] = frame.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    for name, text in texts.items():
        with atomic_write(folder / name) as part:
            part.write_text(text, encoding="utf-8", newline="")
    return [*(folder / name for name in texts), *pictures]


def _frames(result: Result) -> dict[str, pandas.DataFrame]:
    """Tables of the folder by file; a cell without a value is empty.

    The wide one has a row for each participant, as JASP and jamovi want repeated measures.
    """
    ratings, document = result.ratings, result.document
    rows = [
        {**row["measured"], **row, "texture": row["texture_key"], "method": row["method_key"]} for row in ratings.rows
    ]
    numbers = sorted({row["participant"] for row in ratings.rows})
    names = [f"{method}.{texture}" for method in ratings.methods for texture in ratings.textures]
    wide = pandas.DataFrame(ratings.values.reshape(len(numbers), -1), numbers, names).reset_index(names="participant")
    if ratings.simulated:
        wide.insert(1, "simulated", 1)
    pairs = []
    for texture, tests in {"": document["pairs_overall"], **document["pairs_within_textures"]}.items():
        for test in tests:
            first, second = test["pair"]
            numbers_of_test = {name: value for name, value in test.items() if name != "pair"}
            pairs.append({"texture": texture, "first": first, "second": second, **numbers_of_test})
    marked = {
        "pairs.csv": pandas.DataFrame(pairs),
        "answers.csv": pandas.DataFrame(ratings.answers, columns=["participant", "question", "answer", "at"]),
        "participants.csv": _participants(result),
    }
    return {
        "ratings.csv": pandas.DataFrame(rows, columns=[name for name, *_ in DICTIONARY]).astype({"corrected": int}),
        "ratings-wide.csv": wide,
        "dictionary.csv": pandas.DataFrame(DICTIONARY, columns=["column", "meaning", "unit"]),
        **{name: frame.assign(simulated=int(ratings.simulated)) for name, frame in marked.items()},
    }


def _participants(result: Result) -> pandas.DataFrame:
    """Summary of the private answers: a row for a question that has numbers, else a row for each answer."""
    abouts = pandas.DataFrame(result.ratings.abouts, columns=["question", "answer"], dtype=str)
    abouts["answer"] = abouts["answer"].str.split().str.join(" ")
    rows: list[dict[str, Any]] = []
    for question, answers in abouts[abouts["answer"] != ""].groupby("question", sort=False)["answer"]:
        of_question, numbers = {"question": question, "n": len(answers)}, pandas.to_numeric(answers, errors="coerce")
        if np.isfinite(numbers).all():
            rows.append({**of_question, "mean": numbers.mean(), "sd": numbers.std()})
        else:
            rows += [{**of_question, "answer": answer, "count": n} for answer, n in answers.value_counts().items()]
    return pandas.DataFrame(rows, columns=SUMMARY)


def _participants_table(result: Result) -> list[Table]:
    """The same to be read; none where nothing was asked."""
    rows = [
        ["" if pandas.isna(cell) else f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in row]
        for row in _participants(result).itertuples(index=False)
    ]
    notes = (f"The first {MAX_ROWS} of {len(rows)} rows; participants.csv has all.",) if len(rows) > MAX_ROWS else ()
    table = replace(Table.of(SUMMARY, rows[:MAX_ROWS]), title="Participants", notes=notes)
    return [table.known()] if rows else []


def _tables(result: Result) -> list[Table]:
    """Tables for people, but for those of each texture."""
    document, several = result.document, len(result.ratings.textures) > 1
    across = ", averaged across textures" if several else ""
    (one_way,) = document["anova_one_way"]
    effects = [{**one_way, "name": "method, averaged" if several else "method"}, *document["anova_two_way"]]
    tables = [
        _table("Ratings", [row for row in document["means"] if row["texture"] is None], OF_MEANS),
        _table("Analyses of variance", effects, OF_VARIANCE),
        _tests(f"Pairs{across}", document["pairs_overall"], OF_PAIRS, "pairs.csv"),
        _tests(f"Wilcoxon's signed-rank tests{across}", document["wilcoxon"], OF_RANKS, "results.json"),
    ]
    model, agreement = document["mixed_model"], document["reliability"]
    if model is not None:
        tables.append(_table(f"Linear mixed model of all {model['n_ratings']} ratings", model["terms"], OF_MIXED))
    icc = [
        {"of": "of one rater, ICC(2,1)", "value": agreement["icc_single"]},
        {"of": "of the mean of all, ICC(2,k)", "value": agreement["icc_mean"]},
    ]
    each = [{"participant": number, "r": r} for number, r in agreement["with_others"].items()]
    each.sort(key=lambda row: -2.0 if row["r"] is None else row["r"])
    notes = (f"The lowest {MAX_ROWS} of {len(each)}; results.json has all.",) if len(each) > MAX_ROWS else ()
    who = "Each participant's correlation with the others"
    return [
        *_participants_table(result),
        *tables,
        _table("Reliability", icc, {"of": "intraclass correlation", "value": "value"}),
        _table(who, each[:MAX_ROWS], {"participant": "participant", "r": "correlation"}, notes),
    ]


def _within(result: Result) -> list[Table]:
    """Tests within textures: a single table, or a table for each texture where that has too many rows; none of one texture."""
    tests_of = result.document["pairs_within_textures"]
    columns = {key: head for key, head in OF_PAIRS.items() if key != "t"}
    if len(tests_of) == 1:
        return []
    if sum(len(tests) for tests in tests_of.values()) > MAX_ROWS:
        return [_tests(f"Tests within {texture}", tests, columns, "pairs.csv") for texture, tests in tests_of.items()]
    rows = [{"texture": texture, **test} for texture, tests in tests_of.items() for test in tests]
    return [_table(WITHIN, rows, {"texture": "texture", **columns})]


def _tests(title: str, tests: list[dict[str, Any]], columns: dict[str, str], file: str) -> Table:
    """Tests of pairs, those of the lowest p where they are too many, in their order."""
    if len(tests) <= MAX_ROWS:
        return _table(title, tests, columns)
    lowest = sorted(range(len(tests)), key=lambda k: 2.0 if tests[k]["p"] is None else tests[k]["p"])[:MAX_ROWS]
    note = f"The {MAX_ROWS} lowest p of {len(tests)} pairs; {file} has all."
    return _table(title, [tests[k] for k in sorted(lowest)], columns, (note,))


def _table(title: str, rows: Sequence[dict[str, Any]], columns: dict[str, str], notes: tuple[str, ...] = ()) -> Table:
    """Table of rows, with a heading for each key."""
    cells = [[_cell(row, key) for key in columns] for row in rows]
    return replace(Table.of(columns.values(), cells), title=title, notes=notes)


def _cell(row: dict[str, Any], key: str) -> str:
    if key == "ci95":
        return f"{_short(row['ci95_low'])} to {_short(row['ci95_high'])}"
    if key == "pair":
        return " − ".join(row["pair"])
    if key in ("mean", "sd", "difference"):
        return f"{row[key]:.2f}"  # points
    if key == "df":
        return ", ".join(f"{df:.0f}" for df in row["df"])
    return row[key] if isinstance(row[key], str) else _short(row[key])


def _short(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2e}" if 0 < abs(value) < 5e-4 else f"{value:.3f}" if abs(value) < 10 else f"{value:.2f}"


def _html(result: Result, figures: dict[str, str]) -> str:
    title, within = html.escape(result.ratings.title), _within(result)
    parts = [f"<h1>{title}</h1>"]
    if result.ratings.simulated:
        parts.append(f'<p class="mark">{html.escape(MARK)}</p>')
    parts += [f'<p class="note">{html.escape(caution)}</p>' for caution in result.cautions]
    parts.append(f"<h2>Ratings by method and texture</h2><figure>{figures['ratings']}</figure>")
    parts.append("<h2>In words</h2>")
    parts += [f"<p>{html.escape(sentence)}</p>" for sentence in result.sentences]
    parts += [f"<h2>{html.escape(table.title)}</h2>{_html_of(table)}" for table in _tables(result)]
    if within:
        parts.append(f"<h2>{WITHIN}</h2>")
        folded = "<details><summary>{}</summary>{}</details>" if len(within) > 1 else "{1}"
        parts += [folded.format(html.escape(table.title), _html_of(table)) for table in within]
    parts.append(f"<h2>Each texture</h2><figure>{figures['textures']}</figure>")
    parts.append("<p>ratings.csv beside this page holds every rating; dictionary.csv says what its columns mean.</p>")
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title>'
    style = STYLE.read_text(encoding="utf-8")
    body = "\n".join(parts)
    page = f'<html lang="en"><head>{head}<style>{style}</style></head>\n<body><main>\n{body}\n</main></body></html>'
    return f"<!doctype html>\n{page}\n"


def _html_of(table: Table) -> str:
    return "".join(f"<p>{html.escape(note)}</p>" for note in table.notes) + table.html("")


def _markdown(result: Result) -> str:
    parts = [f"# {result.ratings.title}"]
    if result.ratings.simulated:
        parts.append(f"**{MARK}**")
    parts += [f"> {caution}" for caution in result.cautions]
    parts += ["![Ratings by method and texture](ratings.png)", *result.sentences]
    tables = *_tables(result), *_within(result)
    parts += [f"#{html.escape(table.markdown().rstrip(), quote=False)}" for table in tables]  # HTML would pass through
    parts.append("![Each texture](textures.png)")
    return "\n\n".join(parts) + "\n"
