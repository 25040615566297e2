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

MAX_ROWS = 12  # of a table that people read
MAX_ANSWERS_LISTED = 8  # different answers to a question
CI = "95 % CI, not adjusted"
MARK = "Simulated ratings: of a model of raters, and not of people."
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
    columns = [name for name, _, _ in DICTIONARY]
    rows: list[Sequence[Any]] = [columns]
    for row in result.ratings.rows:
        cells = {**row["measured"], **row, "texture": row["texture_key"], "method": row["method_key"]}
        cells["corrected"] = int(row["corrected"])
        rows.append([_cell(cells.get(name)) for name in columns])
    return rows


def _wide(result: Result) -> list[Sequence[Any]]:
    """A row for each participant, as JASP and jamovi want repeated measures; a missing rating is an empty cell."""
    numbers = sorted({row["participant"] for row in result.ratings.rows})
    names = [f"{method}.{texture}" for method in result.ratings.methods for texture in result.ratings.textures]
    rows: list[Sequence[Any]] = [("participant", *(["simulated"] if result.ratings.simulated else []), *names)]
    for number, ratings in zip(numbers, result.ratings.values, strict=True):
        cells = ["" if value != value else f"{value:g}" for value in ratings.reshape(-1)]
        rows.append([number, *([1] if result.ratings.simulated else []), *cells])
    return rows


def _pairs(result: Result) -> list[Sequence[Any]]:
    names = ("difference", "t", "df", "p", "p_bonferroni", "p_holm", "dz", "d_av")
    rows: list[Sequence[Any]] = [("texture", "first", "second", *names, "ci95_low", "ci95_high", "simulated")]
    of = {"": result.document["pairs_overall"], **result.document["pairs_within_textures"]}
    for texture, tests in of.items():
        for test in tests:
            cells = [_cell(value) for value in (*(test[name] for name in names), *test["ci95"])]
            rows.append([texture, *test["pair"], *cells, int(result.ratings.simulated)])
    return rows


def _answers(result: Result) -> list[Sequence[Any]]:
    names = ("participant", "question", "answer", "at")
    rows: list[Sequence[Any]] = [(*names, "simulated")]
    rows += [[*(answer[name] for name in names), int(result.ratings.simulated)] for answer in result.ratings.answers]
    return rows


def _participants(result: Result) -> list[Sequence[Any]]:
    """Summary of the private answers: a row for a question that has numbers, else a row for each answer."""
    rows: list[Sequence[Any]] = [("question", "n", "mean", "sd", "answer", "count", "simulated")]
    for question, answers in _by_question(result).items():
        numbers = _numbers(answers)
        if numbers is not None:
            summary = [_cell(statistics.fmean(numbers)), _cell(_sd(numbers)), "", ""]
            rows.append([question, len(answers), *summary, int(result.ratings.simulated)])
            continue
        for answer, count in Counter(answers).most_common():
            rows.append([question, len(answers), "", "", answer, count, int(result.ratings.simulated)])
    return rows


def _participants_paragraph(result: Result) -> str:
    """The same as a line to read; empty where nothing was asked."""
    parts = []
    for question, answers in _by_question(result).items():
        numbers, counts = _numbers(answers), Counter(answers)
        if numbers is not None:
            sd = _sd(numbers)
            spread = "" if sd is None else f" ± {sd:.1f}"
            parts.append(f"{question} {statistics.fmean(numbers):.1f}{spread} (n = {len(answers)})")
        elif len(counts) <= MAX_ANSWERS_LISTED:
            parts.append(f"{question}: {', '.join(f'{answer} {count}' for answer, count in counts.most_common())}")
        else:
            parts.append(f"{question}: {len(counts)} different answers, in participants.csv")
    return f"{'; '.join(parts)}." if parts else ""


def _by_question(result: Result) -> dict[str, list[str]]:
    """Answers to the private questions; a question that was passed over has none."""
    answers: dict[str, list[str]] = {}
    for row in result.ratings.abouts:
        if answer := " ".join(str(row["answer"]).split()):
            answers.setdefault(row["question"], []).append(answer)
    return answers


def _numbers(answers: Sequence[str]) -> list[float] | None:
    """Answers as numbers, or None where any is none."""
    try:
        numbers = [float(answer) for answer in answers]
    except ValueError:
        return None
    return numbers if all(map(math.isfinite, numbers)) else None


def _sd(numbers: Sequence[float]) -> float | None:
    return statistics.stdev(numbers) if len(numbers) > 1 else None


def _cell(value: Any) -> Any:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else value


@dataclass(frozen=True)
class _Table:
    """A table for people; its first row is the head."""

    title: str
    rows: Sequence[Sequence[str]]
    note: str = ""
    folded: bool = False  # shown when asked for, where a page can


def _tables(result: Result) -> list[_Table]:
    document, several = result.document, len(result.ratings.textures) > 1
    across = ", averaged across textures" if several else ""
    tables = [_means(document["means"]), _analyses_of_variance(document, several)]
    overall = document["pairs_overall"]
    columns = {"t": "t", "p_bonferroni": "p Bonferroni", "p_holm": "p Holm", "dz": "dz"}
    tables.append(_tests(f"Pairs{across}", overall, columns, "pairs.csv", with_difference=True))
    if several:  # else they are those above
        tables += _within(document["pairs_within_textures"])
    columns = {"w": "W", "p": "p", "p_holm": "p Holm", "rank_biserial": "rank-biserial"}
    tables.append(_tests(f"Wilcoxon's signed-rank tests{across}", document["wilcoxon"], columns, "results.json"))
    model = document["mixed_model"]
    if model is not None:
        rows: list[Sequence[str]] = [("effect", "F", "df", "p")]
        rows += [(term["name"], _short(term["f"]), _df(term), _short(term["p"])) for term in model["terms"]]
        tables.append(_Table(f"Linear mixed model of all {model['n_ratings']} ratings", rows))
    return [*tables, *_agreement(document["reliability"])]


def _means(means: list[dict[str, Any]]) -> _Table:
    from scipy import stats

    rows: list[Sequence[str]] = [("method", "mean", "SD", "95 % CI of the mean, not adjusted")]
    for of_method in means:
        if of_method["texture"] is None:
            n, mean, sd = of_method["n"], of_method["mean"], of_method["sd"]
            half = stats.t.ppf(0.975, n - 1) * sd / n**0.5
            rows.append((of_method["method"], f"{mean:.2f}", f"{sd:.2f}", f"{mean - half:.2f} to {mean + half:.2f}"))
    return _Table("Ratings", rows)


def _analyses_of_variance(document: dict[str, Any], several: bool) -> _Table:
    columns = {"epsilon": "ε", "p_corrected": "p (Greenhouse–Geisser)", "partial_eta2": "η² partial"}
    columns |= {"generalised_eta2": "η² generalised", "mauchly_p": "Mauchly p"}
    rows: list[Sequence[str]] = [("effect", "F", "df", *columns.values())]
    (one_way,) = document["anova_one_way"]
    effects = [{**one_way, "name": "method, averaged" if several else "method"}, *document["anova_two_way"]]
    for effect in effects:
        rows.append((effect["name"], _short(effect["f"]), _df(effect), *(_short(effect[key]) for key in columns)))
    return _Table("Analyses of variance", rows)


def _tests(
    title: str,
    tests: list[dict[str, Any]],
    columns: dict[str, str],
    file: str,
    with_difference: bool = False,
    folded: bool = False,
) -> _Table:
    """Tests of pairs, those of the lowest p where they are too many, in their order."""
    shown, note = tests, ""
    if len(tests) > MAX_ROWS:
        lowest = sorted(range(len(tests)), key=lambda k: 2.0 if tests[k]["p"] is None else tests[k]["p"])[:MAX_ROWS]
        shown = [tests[k] for k in sorted(lowest)]
        note = f"The {MAX_ROWS} lowest p of {len(tests)} pairs; {file} has all."
    head = ("pair", *(("difference", CI) if with_difference else ()), *columns.values())
    return _Table(title, [head, *(_test_cells(test, columns, with_difference) for test in shown)], note, folded)


def _test_cells(test: dict[str, Any], columns: dict[str, str], with_difference: bool) -> list[str]:
    interval = [f"{test['difference']:.2f}", " to ".join(map(_short, test["ci95"]))] if with_difference else []
    return [" − ".join(test["pair"]), *interval, *(_short(test[key]) for key in columns)]


def _within(tests_of: dict[str, list[dict[str, Any]]]) -> list[_Table]:
    """Tests within textures: a single table, or a table for each texture where that has too many rows."""
    columns = {"p_bonferroni": "p Bonferroni", "p_holm": "p Holm", "dz": "dz"}
    if sum(len(tests) for tests in tests_of.values()) > MAX_ROWS:
        options = (columns, "pairs.csv", True, True)
        return [_tests(f"Tests within {texture}", tests, *options) for texture, tests in tests_of.items()]
    rows = [[texture, *_test_cells(test, columns, True)] for texture, tests in tests_of.items() for test in tests]
    return [_Table("Tests within textures", [("texture", "pair", "difference", CI, *columns.values()), *rows])]


def _agreement(reliability: dict[str, Any]) -> list[_Table]:
    """Agreement of participants, and those who agree worst with the others."""
    icc: list[Sequence[str]] = [("intraclass correlation", "value")]
    icc.append(("of one rater, ICC(2,1)", _short(reliability["icc_single"])))
    icc.append(("of the mean of all, ICC(2,k)", _short(reliability["icc_mean"])))
    correlations = reliability["with_others"].items()
    lowest_first = sorted(correlations, key=lambda item: -2.0 if item[1] is None else item[1])
    n = len(lowest_first)
    note = f"The lowest {MAX_ROWS} of {n}; results.json has all." if n > MAX_ROWS else ""
    rows = [("participant", "correlation"), *((number, _short(r)) for number, r in lowest_first[:MAX_ROWS])]
    return [_Table("Reliability", icc), _Table("Each participant's correlation with the others", rows, note)]


def _df(effect: dict[str, Any]) -> str:
    return f"{effect['df'][0]:.0f}, {effect['df'][1]:.0f}"


def _short(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2e}" if 0 < abs(value) < 5e-4 else f"{value:.3f}" if abs(value) < 10 else f"{value:.2f}"


def _html(result: Result, svgs: dict[str, str]) -> str:
    esc = html.escape
    parts = [f"<h1>{esc(result.ratings.title)}</h1>"]
    if result.ratings.simulated:
        parts.append(f'<p class="mark">{esc(MARK)}</p>')
    parts += [
        f'<p class="note">{esc(caution)}</p>'
        for caution in result.cautions
        if not (result.ratings.simulated and "model of raters" in caution)
    ]
    parts.append(f"<h2>Ratings by method and texture</h2><figure>{_inline(svgs['ratings'])}</figure>")
    parts.append("<h2>In words</h2>")
    parts += [f"<p>{esc(sentence)}</p>" for sentence in result.sentences]
    if paragraph := _participants_paragraph(result):
        parts.append(f"<h2>Participants</h2><p>{esc(paragraph)}</p>")
    tables = _tables(result)
    for table in tables:
        if table.folded and table == next(t for t in tables if t.folded):
            parts.append("<h2>Tests within textures</h2>")
        parts.append(_html_of(table))
    parts.append(f"<h2>Each texture</h2><figure>{_inline(svgs['textures'])}</figure>")
    parts.append("<p>ratings.csv beside this page holds every rating; dictionary.csv says what its columns mean.</p>")
    body = "\n".join(parts)
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{esc(result.ratings.title)}</title>'
    style = STYLE.read_text(encoding="utf-8")
    page = f'<html lang="en"><head>{head}<style>{style}</style></head>\n<body><main>\n{body}\n</main></body></html>'
    return f"<!doctype html>\n{page}\n"


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
    parts = [f"# {result.ratings.title}"]
    if result.ratings.simulated:
        parts.append(f"**{MARK}**")
    parts += [f"> {caution}" for caution in result.cautions]
    parts += ["![Ratings by method and texture](ratings.png)", *result.sentences]
    if paragraph := _participants_paragraph(result):
        parts += ["## Participants", html.escape(paragraph, quote=False)]  # Markdown lets HTML through
    for table in _tables(result):
        lines = (table.rows[0], ["---"] * len(table.rows[0]), *table.rows[1:])
        parts += [f"## {table.title}", *([table.note] if table.note else [])]
        parts.append("\n".join("| " + " | ".join(line) + " |" for line in lines))
    within: list[str] = []
    for texture, tests in result.document["pairs_within_textures"].items():
        marked = [f"{' − '.join(test['pair'])} {test['difference']:+.1f}{stars(test['p_holm'])}" for test in tests]
        within.append(f"- {texture}: {', '.join(marked)}")
    parts += ["## Within textures (Holm)", "\n".join(within), "![Each texture](textures.png)"]
    return "\n\n".join(parts) + "\n"
