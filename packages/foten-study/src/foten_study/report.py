"""The report of a study: one self-contained HTML page, the same as Markdown, figures, tidy tables and what their columns mean."""

import html
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from foten.atomic_write import atomic_write
from foten.reporting.figure import inline_svg, write_figure
from foten.reporting.table import Table, minus
from foten.untrusted import parse_toml
from foten_study.rating_figures import figures_of
from foten_study.tasks.kind import Ratings, Result
from foten_study.tasks.table import TASKS
from foten_study.variance import MIN_CORRELATED

MAX_ROWS = 12  # of a table that people read; the rest is CSV
CI = "95 % CI, not adjusted"
# Headings of keys of results.json in tables; any other key is its own.
HEADS = {"sd": "SD", "ci95": CI, "p_bonferroni": "p Bonferroni", "p_holm": "p Holm", "w": "W", "r": "correlation"}
HEADS |= {"rank_biserial": "rank-biserial", "name": "effect", "f": "F", "epsilon": "ε", "mauchly_p": "Mauchly p"}
HEADS |= {"p_corrected": "p (Greenhouse–Geisser)", "partial_eta2": "η² partial", "generalised_eta2": "η² generalised"}
HEADS |= {"log_odds": "log-odds", "n_trials": "trials", "d_prime": "d′", "icc": "intraclass correlation"}
OF_PAIRS = ("pair", "difference", "ci95", "p_bonferroni", "p_holm", "dz")
OF_CHOICES = ("pair", "share", "difference", "ci95", "t", "p_bonferroni", "p_holm")
OF_SENSITIVITY = ("pair", "n_trials", "share", "d_prime", "ci95", "p_bonferroni", "p_holm")
OF_VARIANCE = ("name", "f", "df", "epsilon", "p_corrected", "partial_eta2", "generalised_eta2", "mauchly_p")
WINS = {"share": "wins of the first named [%]", "difference": "difference of log-odds"}  # of paired comparisons
MARK = "Simulated ratings: of a model of raters, and not of people."
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
WITHIN = "Tests within textures"
MIN_SUMMED = 3  # private answers: of one alone the mean is the answer
SUMMARY = ["question", "n", "mean", "sd", "answer", "count"]  # of what participants say of themselves
STYLE = Path(__file__).with_name("report.css")
COLUMNS: dict[str, list[tuple[str, str, str]]] = {  # name, meaning, unit
    table: [(name, meaning, unit) for name, (meaning, unit) in columns.items()]
    for table, columns in parse_toml(Path(__file__).with_name("columns.toml").read_bytes()).items()
}


def write_report(results: Sequence[Result], folder: Path) -> list[Path]:
    """Write report.html and .md, results.json, pairs.csv, figures as PDF and PNG, and what `write_data` does; their paths."""
    paths = write_data([result.ratings for result in results], folder)
    svgs: list[dict[str, str]] = []
    for result in results:
        svgs.append({})
        for name, (figure, description) in figures_of(result).items():
            for form in ("png", "pdf"):
                paths.append(folder / f"{name}{_suffix(result, results)}.{form}")
                write_figure(figure, paths[-1], dpi=150)
            letters = name + "abcd"[len(svgs) - 1]
            svgs[-1][name] = inline_svg(figure, letters, description)
    document = {name: results[0].document[name] for name in ("title", "simulated", "software", "task")}
    document["results"] = {result.ratings.key: result.document for result in results}
    texts = texts_of(results, svgs) | {"results.json": json.dumps(document, indent=1, allow_nan=False) + "\n"}
    return [*written(folder, texts | _csv({"pairs.csv": _pairs_frame(results)})), *paths]


def write_data(every: Sequence[Ratings], folder: Path) -> list[Path]:
    """Write ratings.csv (long), ratings-wide.csv, dictionary.csv, answers.csv and participants.csv of answers on some scales,
    also of a single participant; return their paths.

    The wide one has a row for each participant, as JASP and jamovi want repeated measures.
    """
    ratings, tables = every[0], tables_of(every)
    columns = [*tables["ratings"][1], *(tables["thresholds"][1] if "thresholds" in tables else [])]
    wide = pandas.DataFrame({"participant": ratings.numbers})
    for one in every:
        scale = f"{one.key}." if len(every) > 1 else ""
        names = [f"{scale}{condition}.{texture}" for condition in one.conditions for texture in one.textures]
        values = pandas.DataFrame(one.values.reshape(len(one.numbers), -1), columns=names)
        wide = pandas.concat([wide, values], axis=1)
    if ratings.simulated:
        wide.insert(1, "simulated", 1)
    frames = {
        "ratings.csv": tables["ratings"][0],
        "ratings-wide.csv": wide,
        "dictionary.csv": pandas.DataFrame(columns, columns=["column", "meaning", "unit"]),
    }
    for name, (frame, _) in tables.items():
        if name != "ratings":
            frames[f"{name}.csv"] = frame.assign(simulated=int(ratings.simulated))
    return written(folder, _csv(frames))


def tables_of(every: Sequence[Ratings]) -> dict[str, tuple[pandas.DataFrame, list[tuple[str, str, str]]]]:
    """Tables of a study by name, each with its columns (name, meaning, unit), of all tasks and of its own."""
    ratings = every[0]
    left_out = {column for kind in TASKS.values() for column in kind.columns} - {*TASKS[ratings.task.kind].columns}
    columns = [column for column in COLUMNS["ratings"] if column[0] not in left_out]
    rows = sorted(rows_of(every), key=lambda row: (row["participant"], row["trial"]))
    answers = pandas.DataFrame(ratings.answers, columns=["participant", "question", "answer", "at"])
    tables = {
        "ratings": (pandas.DataFrame(rows, columns=[name for name, *_ in columns]), columns),
        "answers": (answers, COLUMNS["answers"]),
        "participants": (participants_frame(ratings), COLUMNS["answers"] + COLUMNS["summary"]),
    }
    if ratings.thresholds:
        of_thresholds = [column for column in COLUMNS["thresholds"] if column[0] in ratings.thresholds[0]]
        tables["thresholds"] = (pandas.DataFrame(ratings.thresholds), of_thresholds)
    return tables


def rows_of(every: Sequence[Ratings]) -> list[dict[str, Any]]:
    """Answers in long form, by the columns of the dictionary."""
    rows = []
    for row in (row for ratings in every for row in ratings.rows):
        tidy = {**row["measured"], **row, "corrected": int(row["corrected"])}
        tidy |= {"texture": row["texture_key"], "method": row["method_key"], "other": row["other_key"]}
        if labels := TASKS[every[0].task.kind].choices:
            number = int(row["rating"])
            tidy |= {"choice": labels[number], "target": labels[row["target"]], "right": int(number == row["target"])}
            tidy["chosen"] = tidy["other"] if number else tidy["method"]
        rows.append(tidy)
    return rows


def _csv(frames: Mapping[str, pandas.DataFrame]) -> dict[str, str]:
    """Texts of tables; a cell without a value is empty."""
    return {name: frame.to_csv(index=False, float_format="%.6g", lineterminator="\n") for name, frame in frames.items()}


def written(folder: Path, texts: Mapping[str, str]) -> list[Path]:
    """Paths of texts that are written into a folder, by name."""
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(folder / name) as part:
            part.write_text(text, encoding="utf-8", newline="")
    return [folder / name for name in texts]


def _suffix(result: Result, results: Sequence[Result]) -> str:
    return f"-{result.ratings.key}" if len(results) > 1 else ""


def _pairs_frame(results: Sequence[Result]) -> pandas.DataFrame:
    """Tests of all pairs, over all textures and of each."""
    rows = []
    for result in results:
        scale = {"scale": result.ratings.key} if len(results) > 1 else {}
        for texture, tests in _tests_by_texture(result)[0].items():
            for test in tests:
                first, second = test["pair"]
                numbers = {name: value for name, value in test.items() if name != "pair"}
                rows.append({**scale, "texture": texture, "first": first, "second": second, **numbers})
    columns = None if rows else ["texture", "first", "second"]
    return pandas.DataFrame(rows, columns=columns).assign(simulated=int(results[0].ratings.simulated))


def _tests_by_texture(result: Result) -> tuple[dict[str, list[dict[str, Any]]], tuple[str, ...]]:
    """Tests of pairs by texture, of all textures under an empty name, and the keys of them that are shown."""
    document = result.document
    if "strengths" in document:
        within = {texture: one["pairs"] for texture, one in document["strengths_within_textures"].items()}
        return {"": document["strengths"]["pairs"], **within}, OF_CHOICES
    if "sensitivity" in document:
        return {"": document["sensitivity"], **document["sensitivity_within_textures"]}, OF_SENSITIVITY
    return {"": document.get("pairs_overall", []), **document.get("pairs_within_textures", {})}, OF_PAIRS


def participants_frame(ratings: Ratings) -> pandas.DataFrame:
    """Private answers in sum: a row of their mean, or a row for each; of fewer than `MIN_SUMMED` people only how many."""
    abouts = pandas.DataFrame(ratings.abouts, columns=["question", "answer"], dtype=str)
    abouts["answer"] = abouts["answer"].str.split().str.join(" ")
    rows: list[dict[str, Any]] = []
    for question, answers in abouts[abouts["answer"] != ""].groupby("question", sort=False)["answer"]:
        of_question, numbers = {"question": question, "n": len(answers)}, pandas.to_numeric(answers, errors="coerce")
        if len(answers) < MIN_SUMMED:
            rows.append(of_question)
        elif np.isfinite(numbers).all():
            rows.append({**of_question, "mean": numbers.mean(), "sd": numbers.std()})
        else:
            rows += [{**of_question, "answer": answer, "count": n} for answer, n in answers.value_counts().items()]
    return pandas.DataFrame(rows, columns=SUMMARY)


def _participants_table(result: Result) -> list[Table]:
    """The same to be read; none where nothing was asked."""
    rows = [
        ["" if pandas.isna(cell) else f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in row]
        for row in participants_frame(result.ratings).itertuples(index=False)
    ]
    notes = (f"The first {MAX_ROWS} of {len(rows)} rows; participants.csv has all.",) if len(rows) > MAX_ROWS else ()
    table = replace(Table.of(SUMMARY, rows[:MAX_ROWS]), title="Participants", notes=notes)
    return [table.known()] if rows else []


def _tables(result: Result) -> list[Table]:
    """Tables for people, but for those of each texture."""
    document = result.document
    if "strengths" in document:
        strengths = _table("Strengths", document["strengths"]["methods"], ("method", "log_odds", "ci95"))
        return [strengths, _tests("Pairs", document["strengths"]["pairs"], OF_CHOICES)]
    if "sensitivity" in document:
        return [_tests("Pairs", document["sensitivity"], OF_SENSITIVITY)]
    heads = {"method": result.ratings.factor, "ci95": "95 % CI of the mean, not adjusted"}
    overall = [row for row in document["means"] if row["texture"] is None]
    means = _table(_title(result), overall, ("method", "mean", "sd", "ci95"), heads=heads)
    return [means, *_tables_of_tests(result)] if "anova_one_way" in document else [means]


def _title(result: Result) -> str:
    quantity = result.ratings.quantity
    return "Ratings" if result.ratings.noun == "ratings" else f"{quantity.capitalize()} [{result.ratings.unit}]"


def _tables_of_tests(result: Result) -> list[Table]:
    document, several = result.document, len(result.ratings.textures) > 1
    across = ", averaged across textures" if several else ""
    (one_way,) = document["anova_one_way"]
    effects = [{**one_way, "name": "method, averaged" if several else one_way["name"]}, *document["anova_two_way"]]
    pairs, ranks = (*OF_PAIRS[:3], "t", *OF_PAIRS[3:]), ("pair", "w", "p", "p_holm", "rank_biserial")
    signed_ranks = f"Wilcoxon's signed-rank tests{across}"
    tables = [
        _table("Analyses of variance", effects, OF_VARIANCE),
        _tests(f"Pairs{across}", document["pairs_overall"], pairs),
        _tests(signed_ranks, document["wilcoxon"], ranks, "results.json"),
    ]
    model, agreement = document["mixed_model"], document["reliability"]
    if model is not None:
        title = f"Linear mixed model of all {model['n_ratings']} {result.ratings.noun}"
        tables.append(_table(title, model["terms"], ("name", "f", "df", "p")))
    icc = [
        {"icc": "of one rater, ICC(2,1)", "value": agreement["icc_single"]},
        {"icc": "of the mean of all, ICC(2,k)", "value": agreement["icc_mean"]},
    ]
    tables.append(_table("Reliability", icc, ("icc", "value")))
    if len(result.ratings.conditions) * len(result.ratings.textures) < MIN_CORRELATED:
        return tables
    each = [{"participant": number, "r": r} for number, r in agreement["with_others"].items()]
    each.sort(key=lambda row: -2.0 if row["r"] is None else row["r"])
    notes = (f"The lowest {MAX_ROWS} of {len(each)}; results.json has all.",) if len(each) > MAX_ROWS else ()
    who = "Each participant's correlation with the others"
    return [*tables, _table(who, each[:MAX_ROWS], ("participant", "r"), notes)]


def _within(result: Result) -> list[Table]:
    """Tests within textures: a single table, or a table for each texture where that has too many rows; none of one texture."""
    tests_of, keys = _tests_by_texture(result)
    del tests_of[""]
    if len(tests_of) < 2:
        return []
    if sum(len(tests) for tests in tests_of.values()) > MAX_ROWS:
        return [_tests(f"Tests within {texture}", tests, keys) for texture, tests in tests_of.items()]
    rows = [{"texture": texture, **test} for texture, tests in tests_of.items() for test in tests]
    return [_table(WITHIN, rows, ("texture", *keys))]


def _tests(title: str, tests: list[dict[str, Any]], keys: Sequence[str], file: str = "pairs.csv") -> Table:
    """Tests of pairs, those of the lowest p where they are too many, in their order."""
    if len(tests) <= MAX_ROWS:
        return _table(title, tests, keys)
    lowest = sorted(range(len(tests)), key=lambda k: 2.0 if tests[k]["p"] is None else tests[k]["p"])[:MAX_ROWS]
    note = f"The {MAX_ROWS} lowest p of {len(tests)} pairs; {file} has all."
    return _table(title, [tests[k] for k in sorted(lowest)], keys, (note,))


def _table(
    title: str,
    rows: Sequence[dict[str, Any]],
    keys: Sequence[str],
    notes: tuple[str, ...] = (),
    heads: Mapping[str, str] | None = None,
) -> Table:
    """Table of some keys of rows, with their headings."""
    if "share" in keys:
        heads = {"share": "right [%]"} if "d_prime" in keys else WINS
    cells, named = [[_cell(row, key) for key in keys] for row in rows], {**HEADS, **(heads or {})}
    return replace(Table.of([named.get(key, key) for key in keys], cells), title=title, notes=notes)


def _cell(row: dict[str, Any], key: str) -> str:
    if key == "ci95":
        ends = ("−∞", "∞") if "d_prime" in row else ("–", "–")
        return " to ".join(
            end if row[k] is None else _short(row[k]) for k, end in zip(("ci95_low", "ci95_high"), ends, strict=True)
        )
    if key == "pair":
        return (", " if "d_prime" in row else " − ").join(row["pair"])
    if key in ("mean", "sd", "difference", "log_odds", "d_prime"):
        return minus(f"{row[key]:.2f}")
    if key == "share":
        return f"{100 * row[key]:.0f}"
    if key == "n_trials":
        return f"{row[key]:.0f}"
    if key == "df":
        return ", ".join(f"{df:.0f}" for df in row["df"])
    return row[key] if isinstance(row[key], str) else _short(row[key])


def _short(value: float | None) -> str:
    if value is None:
        return "–"
    if 0 < abs(value) < 5e-4:
        mantissa, exponent = f"{value:.1e}".split("e")
        return minus(f"{mantissa} · 10{str(int(exponent)).translate(SUPERSCRIPTS)}")
    return minus(f"{value:.3f}" if abs(value) < 10 else f"{value:.2f}")


def texts_of(results: Sequence[Result], figures: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """The report as a page and as Markdown, with each result's figures as SVG by name."""
    parts, title = [*_parts(results, figures)], html.escape(results[0].ratings.title)
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title>'
    style = STYLE.read_text(encoding="utf-8")
    body = "\n".join(part for part, _ in parts)
    page = f'<html lang="en"><head>{head}<style>{style}</style></head>\n<body><main>\n{body}\n</main></body></html>'
    markdown = "\n\n".join(part for _, part in parts if part)
    return {"report.html": f"<!doctype html>\n{page}\n", "report.md": f"{markdown}\n"}


def _parts(results: Sequence[Result], figures: Sequence[Mapping[str, str]]) -> Iterator[tuple[str, str]]:
    """The report in parts, each as HTML and as Markdown."""
    escaped, first = html.escape, results[0].ratings
    yield f"<h1>{escaped(first.title)}</h1>", f"# {first.title}"
    if first.simulated:
        yield f'<p class="mark">{escaped(MARK)}</p>', f"**{MARK}**"
    for result, drawn in zip(results, figures, strict=True):
        suffix, (name, *others) = _suffix(result, results), drawn
        if len(results) > 1:
            quantity = result.ratings.quantity.capitalize()
            yield f"<h2>{escaped(quantity)}</h2>", f"# {quantity}"
        yield from ((f'<p class="note">{escaped(caution)}</p>', f"> {caution}") for caution in result.cautions)
        yield f"<figure>{drawn[name]}</figure><h2>In words</h2>", f"![{_title(result)}]({name}{suffix}.png)"
        yield from ((f"<p>{escaped(sentence)}</p>", sentence) for sentence in result.sentences)
        yield from (_both(table, "<h2>{}</h2>{}") for table in _tables(result))
        if within := _within(result):
            yield f"<h2>{WITHIN}</h2>", ""
            folded = "<details><summary>{}</summary>{}</details>" if len(within) > 1 else "{1}"
            yield from (_both(table, folded) for table in within)
        for name in others:
            yield f"<h2>Each texture</h2><figure>{drawn[name]}</figure>", f"![Each texture]({name}{suffix}.png)"
    yield from (_both(table, "<h2>{}</h2>{}") for table in _participants_table(results[0]))
    yield "<p>ratings.csv beside this page holds every answer; dictionary.csv says what its columns mean.</p>", ""


def _both(table: Table, form: str) -> tuple[str, str]:
    """A table as HTML, with its title, and as Markdown, which HTML in a name would pass through."""
    notes = "".join(f"<p>{html.escape(note)}</p>" for note in table.notes)
    markdown = html.escape(table.markdown().rstrip(), quote=False)
    return form.format(html.escape(table.title), notes + table.html("")), f"#{markdown}"
