"""Put the tables into README.md and the pages of docs/, each between its markers, from the CSV files in docs/results.

    python docs/make/tables.py [--check] [--add DIR [--recordings DIR]]

`docs/results/EXPERIMENT.csv` is the `runs.csv` that `foten tables` writes of a sweep, `paper.csv` those of the paper's tables,
which --add puts there; the others are what benchmarks keep by `--csv`. With --check nothing is written, and the exit status is 1
where a page is not what the CSV files give. A table without a CSV says so.
"""

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import csv_records as data
import main_tables
import paper_findings
import paper_tables
import trial_tables
from csv_records import FULL_LENGTH, MAIN, REAL_2_5, REAL_10, REAL_TABLE_1, place_of, runs_of
from foten.atomic_write import atomic_write
from foten.reporting.table import Table
from foten_lab.experiment import experiment_path, read_experiment
from foten_lab.method_tables import brief, same_blocks
from foten_lab.results import Records, read_records, runs_table

MAX_COLUMNS, MAX_ROWS = 8, 12  # of a table that people read, a row of means not counted; the rest is CSV
NOT_RUN = "*Not measured yet with this version.*"


def core_hours(records: Records) -> str:
    """Hours of training and evaluation, a dash where the CSV lacks them."""
    seconds = [record.get(key) for record in records for key in ("training_s", "evaluation_s")]
    return "–" if None in seconds else f"{sum(seconds) / 3600:.1f}"


def note_of(name: str, runs: Records) -> str:
    """Note of an experiment: that of when it was run, where the CSV has it."""
    return str((runs[0]["note"] if runs else "") or data.of_file(name)["note"]).rstrip(".")


def experiments() -> Table:
    """What the other experiments are of, and what the runs in their CSV files took."""
    of_each = {name: data.records_of(name) for name in (*MAIN, "listener")}
    rows = [(f"`{name}`", note_of(name, runs), str(len(runs)), core_hours(runs)) for name, runs in of_each.items()]
    return Table.of(("experiment", "what", "runs", "core-hours"), rows)


VERSIONS = {
    "cc4c4292": {"69404639f09a9196", "0c720e2e7db4e48b", "07ba0a3fa116e97d", "f05e4aa1c77ccf15"},
    "2f0f0d6e": {"7e5f9516d6af35bf", "396feffc46c5c2bb", "daed59569aa57f0e", "7a51214710a5daa5", "44f1efb5c1cd1f53"},
    "2a974bd7": {"29401e15b6d05a20", "7d77f7c7239854cc"},
    "214eeaf5": {"738830bef19dd066", "0ace9ef399e18463"},
    "7f9c20f6": {"41cfd2eadd7b0421", "0eb6489a5b1c9a5e"},
    "de196384": {"76b8bfeda814ed1e", "6b16428f170112c5", "9ba591cf4608b851"},
}
"""Commits that runs are of, and their `code`; a digest of before covers what a model's runs import: commits may share some."""


def commit_of(code: object) -> str:
    """Commit that the `code` of a run is of; `other` where `VERSIONS` does not have it."""
    return next((commit for commit, codes in VERSIONS.items() if code in codes), "other")


def versions() -> Table:
    """How many runs of the paper's and the main tables are of which commit; of none that is known: others, older ones too."""
    runs: dict[str, list[str]] = {commit: [] for commit in (*VERSIONS, "other")}
    for name in JOINED:
        records = runs_of(name)
        for commit, n in Counter(commit_of(record["code"]) for record in records).items():
            runs[commit].append(f"`{name}`" + (f" ({n} of {len(records)})" if n < len(records) else ""))
    for commit in dict.fromkeys(commit_of(row["code"]) for row in data.csv_rows("efficiency")):
        runs[commit].append("Table III on the CPU")
    return Table.of(("commit", "runs of"), [(commit, ", ".join(of)) for commit, of in runs.items() if of])


def spent() -> Table:
    """Runs of the paper's tables at full length and of the main tables that are done, and what they took."""
    rows = []
    for name in (*FULL_LENGTH, REAL_TABLE_1):
        records = runs_of(name)
        done = str(len(records))
        if name not in (data.BEHIND_LOW_PASS, REAL_TABLE_1):  # which need recordings
            runs = read_experiment(experiment_path(name)).runs()
            # Those of the network in Table II are runs of Table I.
            done += f" of {sum((name, run.model) != ('table-2', 'foten') for run in runs)}"
        rows.append((f"`{name}`", done, core_hours(records)))
    main = [record for name in MAIN for record in runs_of(name)]
    every = main + [record for name in (*FULL_LENGTH, REAL_TABLE_1) for record in runs_of(name)]
    rows.append(("main tables", str(len(main)), core_hours(main)))
    rows.append(("**all**", str(len(every)), f"**{core_hours(every)}**"))
    return Table.of(("experiment", "runs done", "core-hours"), rows)


def made_anew() -> Table:
    """Cells of the paper's tables made again on another instruction set: one-step errors [sd] beside those of the tables."""
    published = {(record["experiment"], *place_of(record)): record for record in data.records_of("paper")}
    titles = {data.of_file(name)["title"]: name for name in FULL_LENGTH}
    rows = []
    for record in data.records_of("made-anew"):
        cell = published[(record["experiment"], *place_of(record))]
        if record["platform"] != cell["platform"]:
            here, there = record[data.ONE_STEP], cell[data.ONE_STEP]
            method = data.VARIANTS.get(record["method"], record["method"])
            shown = f"`{titles[record['experiment']]}`", f"{method}, {record['texture']}"
            rows.append((*shown, f"{there:.4f}", f"{here:.4f}", f"{100 * (here / there - 1):+.1f}"))
    return Table.of(("experiment", "cell", "MAE [sd]", "again", "difference [%]"), rows)


def listed(*names: str) -> str:
    """Links to the runs of experiments that have been run."""
    lines = []
    for name in names:
        if records := runs_of(name):
            lines.append(f"- [{name}](results/{FULL_LENGTH.get(name, name)}.csv): {note_of(name, records)}")
    return "\n".join(lines)


BENCHMARKS = ("step", "contacts", "soak", "install", "studio-page", "studio-load", "study")
TABLES: dict[str, dict[str, Callable[[], Table | str]]] = {
    "../README.md": {
        "readme": main_tables.readme,
        "readme-systems": main_tables.readme_systems,
        "readme-notes": main_tables.readme_notes,
    },
    "results.md": {
        "short": main_tables.short,
        "levels": paper_findings.levels,
        "seconds": partial(paper_findings.seconds_of_test, REAL_10),
        "real": partial(main_tables.of_each_texture, REAL_10, REAL_2_5),
        "real-same": lambda: " ".join(dict.fromkeys(same_blocks([*data.runs(REAL_10), *data.runs(REAL_2_5)]))),
        "linear": partial(main_tables.of_each_texture, data.LINEAR),
        "simulated": partial(main_tables.of_each_texture, data.SIMULATED),
        "contact": partial(main_tables.of_each_texture, data.CONTACT),
        "stability": main_tables.stability,
        "chaotic": main_tables.chaotic,
        "onset": main_tables.onset,
        "abrupt": trial_tables.abrupt,
        "abrupt-filter": trial_tables.abrupt_filter,
        "abrupt-surfaces": trial_tables.abrupt_surfaces,
        "parts": trial_tables.parts,
        "csv": partial(listed, *MAIN, "listener"),
    },
    "listener.md": {
        "listener": main_tables.listener,
        "listener-notes": main_tables.listener_notes,
        "hands": trial_tables.hands,
        "trials": trial_tables.trials,
    },
    "less-than-a-recording.md": {
        "few-strokes": trial_tables.few_strokes,
        "few-strokes-real": trial_tables.few_strokes_real,
        "tools": trial_tables.tools,
        "users": trial_tables.users,
        "session": trial_tables.users_session,
        "words": trial_tables.words,
    },
    "compared.md": {**paper_tables.TABLES, "csv": partial(listed, *FULL_LENGTH, REAL_TABLE_1)},
    "reproduce.md": {"experiments": experiments, "versions": versions, "made-anew": made_anew, "spent": spent},
    "runtime.md": {name: partial(data.listing, name) for name in BENCHMARKS},
}


def pages() -> Iterator[tuple[Path, str, str]]:
    """Yield each page, what it says, and what it should."""
    for page, tables in TABLES.items():
        path = (data.DOCS / page).resolve()
        before = text = path.read_text(encoding="utf-8")
        for name, make in tables.items():
            begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
            head, _, after = text.partition(begin)
            _, closed, tail = after.partition(end)
            if not closed:
                raise ValueError(f"{path.name}: has no {begin} … {end} to put a table between")
            content = make()
            if isinstance(content, Table):
                n_rows = sum(str(row[0]) != "mean" for row in content.rows)
                if len(content.columns) > MAX_COLUMNS or n_rows > MAX_ROWS:
                    size = f"{len(content.columns)} columns and {n_rows} rows"
                    raise ValueError(f"{name}: {size}, expected {MAX_COLUMNS} and {MAX_ROWS} at most")
                content = content.markdown() if content.known().rows else ""
            text = f"{head}{begin}\n{content.rstrip() or NOT_RUN}\n{end}{tail}"
        yield path, before, text


JOINED = (*FULL_LENGTH, REAL_TABLE_1, *MAIN, "listener")
"""Experiments that are run in parts, in the order of their versions."""
KEPT_FIGURES = {"figure-5": ("one_step", "validation"), "recipes": ("one_step", "references", "validation")}
"""Figures that are kept of an experiment of many runs."""


def add(folder: Path, recordings: Path | None) -> None:
    """Put the results of a sweep, all or a part, into the CSV of their experiment, beside what the CSV has of its other runs."""
    records = brief(read_records(folder))
    title = records[0]["experiment"]
    name = next((name for name in JOINED if data.of_file(name)["title"] == title), None)
    if name is None:
        sys.exit(f"{title!r} is none of {', '.join(JOINED)}: write its CSV by foten tables, as docs/reproduce.md says")
    if name in KEPT_FIGURES:
        records = [
            {key: one[key] for key in one if key.partition(".")[0] in KEPT_FIGURES[name] or "." not in key}
            for one in records
        ]
    file = FULL_LENGTH.get(name, name)
    parts = {other: runs_of(other) for other in JOINED if FULL_LENGTH.get(other, other) == file}
    experiment = read_experiment(experiment_path(name), recordings)
    places = [run.place for run in experiment.runs()]
    others = {*places} - {*map(place_of, records)}
    kept = [record for record in parts[name] if place_of(record) in others]  # not what the experiment has no more
    described = [one | {"note": experiment.note} for one in (*records, *kept)]  # as it is now, of earlier runs too
    parts[name] = sorted(described, key=lambda one: places.index(place_of(one)))
    runs_table([record for part in parts.values() for record in part], 4).write(data.RESULTS / f"{file}.csv")


def main() -> None:
    parser = data.parser_of(__doc__)
    parser.add_argument("--check", action="store_true", help="exit 1 where a page is not what the CSV files give")
    parser.add_argument("--add", type=Path, metavar="DIR", help="first put the results of a sweep into their CSV")
    parser.add_argument(
        "--recordings", type=Path, metavar="DIR", help="recordings that the sweep is of, where they are files"
    )
    arguments = parser.parse_args()
    if arguments.add:
        add(arguments.add, arguments.recordings)
        data.records_of.cache_clear()
    stale = [(path, text) for path, before, text in pages() if before != text]
    if arguments.check and stale:
        sys.exit(f"{', '.join(path.name for path, _ in stale)}: run 'python docs/make/tables.py' and commit it")
    for path, text in stale:
        with atomic_write(path) as part:
            part.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
