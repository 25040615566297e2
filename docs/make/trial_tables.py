"""Tables of trials, abrupt changes, few strokes, tools, users and words, from the CSV files that scripts and benchmarks write."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from csv_records import OURS, Row, csv_rows, numbers, rows_with, with_error
from foten.dsp.inference import standard_error
from foten.reporting.table import Number, Table, mean_number

N_CONTACT_TRIALS = 10  # five surfaces, two fits of each


def by_surface(rows: Sequence[Row]) -> list[list[Row]]:
    """Rows of surfaces of contact, and of linear processes."""
    return [[row for row in rows if row["surface"].startswith("linear-") == linear] for linear in (False, True)]


def trials() -> Table:
    """Mean areas of approaches that were tried on all surfaces of other physics of one half, beside controls."""

    def area(some: Sequence[Row], name: str) -> str:
        return format(numbers(some, name).mean(), ".3f") if some else "–"

    rows = [row for row in csv_rows("trials") if row["person"]]
    lines = []
    for approach, half in dict.fromkeys((row["approach"], row["half"]) for row in rows):
        of_it = rows_with(rows, approach=approach, half=half)
        contact, linear = by_surface(of_it)
        if len(contact) >= N_CONTACT_TRIALS:
            worst = max(contact, key=lambda row: float(row["ideal"]))
            of_contact = area(contact, "ideal"), f"{float(worst['ideal']):.2f} ({worst['surface']})"
            others = area(contact, "person"), area(linear, "ideal"), area(linear, "person")
            lines.append((approach, half, *of_contact, *others, area(of_it, "ideal_control")))
    of_each = ("contact: ideal", "worst", "person's limits", "linear: ideal", "person's limits ", "control")
    return Table.of(("what was changed", "half", *of_each), lines)


OTHER_HANDS = {
    f"what stands, hand of {factor:g} times the speed{suffix}": (f"{factor:g} times as quick", joined)
    for factor in (0.6, 1.7)
    for suffix, joined in (("", "blocks of 2 s"), (", DFT321 in windows of 64 ms", "windows of 64 ms"))
}
"""Approaches of the trials under other hands than the one that was learned from; how quick they are, and how axes became one."""


def hands() -> Table:
    """Bias of level by quarter of speed under another hand, mean and standard error over surfaces."""

    def bias(rows: Sequence[Row], quarter: int) -> str:
        values = numbers(rows, f"bias_{quarter}_db")
        return f"{values.mean():+.2f} ± {standard_error(values):.2f}"

    of_hands = {labels: rows_with(csv_rows("trials"), approach=name) for name, labels in OTHER_HANDS.items()}
    lines = [(*labels, *(bias(rows, k) for k in range(1, 5))) for labels, rows in of_hands.items() if rows]
    quarters = [f"{name} [dB]" for name in ("slowest", "second", "third", "fastest")]
    return Table.of(("hand that listens", "DFT321 in", *quarters), lines)


WITH = "recorded, no network in the loop"
PARTS = {
    "network in the loop, trained there": ("recorded innovations", WITH),
    "distance of band envelopes that chooses the linear part": (WITH, "recorded, linear part by its errors"),
    "equaliser": (WITH, "recorded, no equaliser"),
    "table of reflection coefficients": (WITH, "recorded, one filter"),
    "tones": (WITH, "recorded, no tones"),
    "orders above 40": (WITH, "recorded, orders up to 40"),
    "level before the filter": (WITH, "recorded, level after the filter"),
}
"""Parts, and the approaches of the trials with and without them; a fit without a row is the same without the part."""


def parts() -> Table:
    """What each part takes off the area of the ideal listener, on fits of the choosing half and the simulated textures."""
    by_approach: dict[str, dict[tuple[str, ...], float]] = {}
    for row in csv_rows("trials"):
        place = row["half"], row["surface"], row["fit"]
        by_approach.setdefault(row["approach"], {})[place] = float(row["ideal"])

    def mean(gains: Sequence[float]) -> str:
        values = np.array(gains)
        return f"{values.mean():+.3f} ± {standard_error(values) or 0.0:.3f}" if gains else "–"

    cells = []
    for part, (with_part, without) in PARTS.items():
        areas, changed = by_approach[with_part], by_approach[without]
        if without == WITH:
            areas = {place: area for place, area in areas.items() if place in changed}
        gains = {place: changed.get(place, area) - area for place, area in areas.items()}
        linear = {place: place[1].startswith("linear-") for place in gains}
        kinds = [[gain for place, gain in gains.items() if linear[place] == kind] for kind in (False, True)]
        cells.append((part, f"{np.count_nonzero([*gains.values()])} of {len(areas)}", *map(mean, kinds)))
    return Table.of(("part", "fits that it changes", "gain, other surfaces", "gain, linear processes"), cells)


FEW_STROKES: Mapping[str, str] = {
    "before": "before: fade below, hold above",
    "held": "held",
    "law": "law",
    "ours": "ours",
    "full": "64 s of a moving hand",
}
"""Policies of docs/make/extrapolation.py, as people read them."""


def few_strokes() -> Table:
    """Errors at speeds and forces that were not recorded, on simulated textures, by policy."""
    rows = [row for row in csv_rows("few-strokes") if row["lsd_db"]]
    names = ("level_error_db", "lsd_db")
    cells = [
        (words, *(mean_number([numbers(of_policy, name)], 2) for name in names))
        for policy, words in FEW_STROKES.items()
        if (of_policy := rows_with(rows, policy=policy))
    ]
    return Table.of(("", "level error [dB]", "log-spectral distance [dB]"), cells)


def few_strokes_real() -> Table:
    """The same of the level alone, by policy and real recording."""
    rows = [row for row in csv_rows("few-strokes") if not row["lsd_db"]]
    textures = dict.fromkeys(row["texture"] for row in rows)

    def level(policy: str, texture: str) -> Number:
        return mean_number([numbers(rows_with(rows, policy=policy, texture=texture), "level_error_db")], 2)

    cells = [(policy, *(level(policy, texture) for texture in textures)) for policy in ("held", "law") if rows]
    return Table.of(("level error [dB]", *textures), cells)


SECOND = "second realisation"
HANDS = ("live", "aligned", "unfiltered")
GROUPS = {
    "steps of speed, reversal": ("speed 40", "speed 200", "reversal"),
    "steps of force": ("force 0.5", "force 2"),
    "taps": ("tap",),
    "out of range": ("speed 100", "force 1"),
}
"""Kinds of changes, by how their names begin."""


def abrupt_median(rows: Sequence[Row], name: str, spec: str = ".1f") -> Number:
    """Median over surfaces; an empty cell counts as never."""
    values = [float(row[name] or "inf") for row in rows]
    median = float(np.median(values)) if values else np.inf
    return Number(median if np.isfinite(median) else None, spec)


def abrupt() -> Table:
    """Level and spectrum in the 100 ms after each change, medians over the surfaces that both models learned."""
    both = {row["surface"] for row in rows_with(csv_rows("abrupt"), rendering="foten")}
    rows = [row for row in csv_rows("abrupt") if row["surface"] in both]
    changes = dict.fromkeys(row["change"] for row in rows)
    lines = []
    for change, some in {**{name: rows_with(rows, change=name) for name in changes}, "all": rows}.items():
        hands = {SECOND: "", OURS: "live", "foten": "live"}
        judged = {name: rows_with(some, rendering=name, hand=hand) for name, hand in hands.items()}
        figures = (abrupt_median(of, name) for name in ("level_error_db", "lsd_db") for of in judged.values())
        lines.append((change, *figures, abrupt_median(judged[OURS], "settled_level_error_db")))
    heads = ("", "level: second realisation [dB]", OURS, "foten", "spectrum: second realisation [dB]", OURS, "foten")
    return Table.of((*heads, f"level later: {OURS} [dB]"), lines)


def abrupt_filter() -> Table:
    """What the low-pass of speed and force costs after each change: level error and time of arrival, medians over surfaces."""
    rows = rows_with(csv_rows("abrupt"), rendering=OURS)
    columns = [*product((("level_error_db", ".1f"), ("arrives_ms", ".0f")), HANDS)]
    cells = [
        (change, *(abrupt_median(rows_with(rows, change=change, hand=hand), *column) for column, hand in columns))
        for change in dict.fromkeys(row["change"] for row in csv_rows("abrupt"))
    ]
    return Table.of(("", "level error: live [dB]", *HANDS[1:], "arrives: live [ms]", *HANDS[1:]), cells)


def abrupt_surfaces() -> Table:
    """Level errors in the 100 ms after changes of a kind, by surface: live, unfiltered, of a second realisation."""

    def figure(surface: str, kinds: Sequence[str], rendering: str, hand: str = "") -> str:
        rows = rows_with(csv_rows("abrupt"), surface=surface, rendering=rendering, hand=hand)
        errors = numbers([row for row in rows if row["change"].startswith(tuple(kinds))], "level_error_db")
        return f"{errors.mean():.1f}" if errors.size else "–"

    cells = []
    for surface in dict.fromkeys(row["surface"] for row in rows_with(csv_rows("abrupt"), rendering=OURS)):
        row = [surface]
        for kinds in GROUPS.values():
            live, unfiltered = (figure(surface, kinds, OURS, hand) for hand in ("live", "unfiltered"))
            row.append(f"{live} → {unfiltered} ({figure(surface, kinds, SECOND)})")
        cells.append((*row, figure(surface, (*GROUPS["steps of force"], *GROUPS["taps"]), "flat surface")))
    return Table.of(("", *GROUPS, "a flat surface, force and taps"), cells)


def words() -> Table:
    """What names are worth over a library, by method."""
    figures = (("lsd_db", "lsd_interval"), ("level_error_db", "level_interval"), ("emd_octaves", "emd_interval"))
    cells = [(row["method"], *(with_error(row, *columns) for columns in figures)) for row in csv_rows("words")]
    return Table.of(("", "log-spectral distance [dB]", "level error [dB]", "earth mover's [octave]"), cells)


def tools() -> Table:
    """What a tool's filter is worth, by method."""
    figures = (("level_error_db", "level_se"), ("lsd_db", "lsd_se"))
    cells = [
        (row["tools"], row["method"], *(with_error(row, *columns, ".1f") for columns in figures))
        for row in csv_rows("tools")
    ]
    return Table.of(("", "", "level error [dB]", "log-spectral distance [dB]"), cells)


def users() -> Table:
    """How well simulated people are known after how many answers."""
    rows = [row for row in csv_rows("users") if not row["what"].startswith("session") and row["answers"] != "0"]
    cells = {(row["what"], row["procedure"], row["answers"]): row for row in rows}
    answers = sorted({row["answers"] for row in rows}, key=int)
    lines = [
        (*kind, *(with_error(cells[*kind, n], "distance", "distance_se", ".1f") for n in answers))
        for kind in dict.fromkeys((row["what"], row["procedure"]) for row in rows)
    ]
    return Table.of(("", "", *(f"{n} answers" for n in answers)), lines)


def users_session() -> Table:
    """What the session of `foten adapt` takes and gives."""

    def shown(row: Row, name: str, spec: str) -> str:
        return format(float(row[name]), spec) if row[name] else ""

    figures = (("bias", "+.1f"), ("spread", ".1f"), ("distance", ".1f"))
    cells = [
        (row["what"].removeprefix("session: "), row["answers"], *(shown(row, *figure) for figure in figures))
        for row in csv_rows("users")
        if row["what"].startswith("session")
    ]
    return Table.of(("the session", "answers", "bias", "spread", "mean error, or time"), cells)
