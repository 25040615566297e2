"""A study for the record: as a Psych-DS data set (its conventions of 2025), and as behavioural events in BIDS.

Source: Gorgolewski et al., Scientific Data 3, 160044 (2016), for BIDS.
"""

import io
import json
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from foten import __version__
from foten.recording.recording import counted
from foten_study.analysis import read_ratings
from foten_study.design import task_of
from foten_study.orders import Trial
from foten_study.report import COLUMNS, tables_of, written
from foten_study.store import MAX_APART_S, Store, Stroked, measured_of
from foten_study.study_file import Stimulus
from foten_study.tasks.kind import Ratings, TaskKind
from foten_study.tasks.table import TASKS

BIDS_VERSION = "1.9.0"
EVENTS = {name: (meaning, unit) for name, meaning, unit in COLUMNS["events"]}


def psych_ds(store: Store) -> dict[str, str]:
    """Texts of a Psych-DS data set by file: a tidy table of all answers, those to questionnaires, and what every column means.

    Answers to private questions are there in sum, without numbers of participants. ValueError where there is no answer yet.
    """
    every = read_ratings(store)
    ratings = every[0]
    study = re.sub(r"[^a-zA-Z0-9]", "", ratings.title)[:40] or "study"
    name = f"study-{study}_task-{ratings.task.kind}"
    variables: dict[str, tuple[str, str]] = {}
    frames = {}
    for table, (frame, columns) in tables_of(every).items():
        if table == "ratings" or len(frame):
            frames[f"{name}{'' if table == 'ratings' else f'_description-{table}'}_data.csv"] = frame
            variables |= {column: (meaning, unit) for column, meaning, unit in columns}
    description = {
        "@context": "https://schema.org",
        "@type": "Dataset",
        "name": ratings.title,
        "description": _description(ratings),
        "variableMeasured": [
            {"@type": "PropertyValue", "name": column, "description": meaning} | ({"unitText": unit} if unit else {})
            for column, (meaning, unit) in variables.items()
        ],
    }
    texts = {
        "dataset_description.json": _json(description),
        "README.md": f"# {ratings.title}\n\n{_description(ratings)}\n\nWhat columns mean: `dataset_description.json`.\n",
        "CHANGES.md": f"# Changes\n\n- exported by foten {__version__}\n",
    }
    for file, frame in frames.items():
        texts[f"data/{file}"] = frame.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    return texts


def bids(store: Store) -> dict[str, str]:
    """Texts of a BIDS data set by file: each participant's trials, contacts, switches and answers as events in time.

    A contact's time is that of its storing less the pen's own clock, right to about the delay of the network. ValueError where
    there is no answer yet.
    """
    every = read_ratings(store)
    ratings = every[0]
    description = {
        "Name": ratings.title,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "foten", "Version": ratings.software}],
    }
    columns = {
        column: {"Description": meaning} | ({"Units": unit} if unit else {})
        for column, (meaning, unit) in EVENTS.items()
        if column not in ("onset", "duration")
    }
    width = len(str(max(ratings.numbers)))
    texts = {
        "dataset_description.json": _json(description),
        "README": f"{ratings.title}\n\n{_description(ratings)}\n",
        "participants.tsv": "participant_id\n" + "".join(f"sub-{n:0{width}d}\n" for n in ratings.numbers),
        f"task-{ratings.task.kind}_events.json": _json(columns),
    }
    for number in ratings.numbers:
        frame = pandas.DataFrame(events_of(store, number), columns=list(EVENTS))
        tsv = frame.to_csv(index=False, sep="\t", float_format="%.3f", na_rep="n/a", lineterminator="\n")
        texts[f"sub-{number:0{width}d}/beh/sub-{number:0{width}d}_task-{ratings.task.kind}_events.tsv"] = tsv
    return texts


def _json(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _description(ratings: Ratings) -> str:
    who = counted(len(ratings.numbers), "simulated rater" if ratings.simulated else "participant")
    methods, textures = counted(len(ratings.methods), "method"), counted(len(ratings.textures), "texture")
    return (
        f"A study of virtual surfaces, by foten {ratings.software}: {who}, task {ratings.task.kind}, "
        f"{methods} ({', '.join(ratings.methods)}) on {textures} ({', '.join(ratings.textures)})."
    )


def events_of(store: Store, participant: int) -> list[dict[str, Any]]:
    """Events of a participant in the order of time, each by the columns of `EVENTS`."""
    stimuli, trials = store.stimuli(), {trial.number: trial for trial in store.trials(participant)}
    kind = TASKS[task_of(str(store.study["design"])).kind]
    names, choices = kind.intervals or ("virtual",), kind.choices
    events: list[dict[str, Any]] = []
    answered: dict[int, float] = {}
    for row in store.moments(participant, "ratings"):
        answered[row["trial"]] = row["at_s"]
        answer = {"at": row["at_s"], "trial_type": "answer", "trial": row["trial"], "scale": row["scale"]}
        answer["value"] = choices[int(row["rating"])] if choices else row["rating"]
        if kind.order.n_targets:
            answer["right"] = int(row["rating"] == trials[row["trial"]].target)
        events.append({**answer, "level_db": measured_of(row).get("level_db")})
    for row in store.moments(participant, "switches"):
        surface = row["side"].removeprefix("virtual ")
        events.append({"at": row["at_s"], "trial_type": "switch", "trial": row["trial"], "surface": surface})
    for row in store.moments(participant, "shown"):
        duration = max(0.0, answered.get(row["trial"], row["at_s"]) - row["at_s"])
        events.append({"at": row["at_s"], "duration": duration, "trial_type": "trial", "trial": row["trial"]})
    for number in sorted(trials):
        for at, duration, interval in _contacts(store.parts(participant, number)):
            contact = {"at": at, "duration": duration, "trial_type": "contact", "trial": number}
            events.append({**contact, "surface": names[interval]})
    events.sort(key=lambda event: event["at"])
    shown = [event["at"] for event in events if event["trial_type"] == "trial"] or [event["at"] for event in events]
    for event in events:
        event |= {"onset": event["at"] - shown[0], **_conditions(stimuli, trials[event["trial"]], kind)}
    return [{"duration": 0.0, **event} for event in events]


def _conditions(stimuli: Mapping[tuple[int, int], Stimulus], trial: Trial, kind: TaskKind) -> dict[str, Any]:
    """What a trial compared."""
    shown = stimuli[trial.texture, trial.method]
    other = None if trial.other is None else stimuli[trial.texture, trial.other].method_key
    target = kind.choices[trial.target] if kind.order.n_targets else None
    return {"texture": shown.texture_key, "method": shown.method_key, "other": other, "target": target}


def _contacts(parts: Sequence[Stroked]) -> list[tuple[float, float, int]]:
    """Contacts of a trial: system time of its begin [s], how long it lasted [s], and the number of the surface."""
    parts = [part for part in parts if len(part.events)]
    if not parts:
        return []
    interval = np.concatenate([np.full(len(part.events), part.interval) for part in parts])
    events = np.concatenate([part.events for part in parts])
    stored = np.concatenate([np.full(len(part.events), part.at_s) for part in parts])
    times, down = events[:, 3], events[:, 2] > 0
    step = np.diff(times, prepend=times[0])
    clock = np.cumsum(step < 0)  # a page that was loaded again begins to count anew
    # An event is stored when it comes or later: the clocks differ by the least of all.
    offset = np.array([(stored - times)[clock == k].min() for k in range(clock[-1] + 1)])
    goes_on = np.append(
        False, down[:-1] & (interval[1:] == interval[:-1]) & (step[1:] >= 0) & (step[1:] <= MAX_APART_S)
    )
    begins = np.flatnonzero(down & ~goes_on)
    contacts = []
    for begin, limit in zip(begins, [*begins[1:], len(times)], strict=True):
        end = begin + int(np.argmin(np.append(goes_on[begin + 1 : limit], False)))
        at = float(offset[clock[begin]] + times[begin])
        contacts.append((at, float(times[end] - times[begin]), int(interval[begin])))
    return contacts


FORMATS: Mapping[str, Callable[[Store], dict[str, str]]] = {"psych-ds": psych_ds, "bids": bids}


def write_record(store: Store, form: str, folder: Path) -> list[Path]:
    """Write a study in a form of `FORMATS` into a folder; the paths of its files."""
    return written(folder, FORMATS[form](store))


def zipped(store: Store) -> bytes:
    """A study in all forms, a folder each, as a ZIP file."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for form, texts_of in FORMATS.items():
            for name, text in texts_of(store).items():
                archive.writestr(f"{form}/{name}", text)
    return buffer.getvalue()
