"""Sentences of *Compared systems*: what its tables show, with p-values and intervals, from the CSV files in docs/results."""

from collections.abc import Iterable, Mapping
from itertools import pairwise

import numpy as np

import csv_records as data
from csv_records import AR_LSD, BEST_AR, EXCITED, LEVEL, LSD, MAIN, ONE_STEP, OURS
from foten.dsp.inference import holm, student_quantile
from foten.evaluate.warm_start import SILENT_DB
from foten.recording.windows import first_scored
from foten_lab.aggregate import (
    Row,
    by_place,
    by_texture,
    complete,
    mean_of,
    over_textures,
    paired,
    rows_of,
    signed_rank,
)
from foten_lab.experiment import experiment_path, read_experiment
from foten_lab.method_tables import BY_RECIPE, findings, same_blocks
from foten_lab.results import VALIDATION, WITHOUT, Record, Records, chosen

SYSTEM_NAMES = {"ar": "AR", "fnn": "FNN", "dstn": "DSTN", "ldhtd": "LDHTD", "gan": "GAN", "foten": "FoTEN"}
QUICKER = 0.9  # times the seconds of another in one run of the benchmark, so that chance alone does not make an order
COMPARED = ("dstn", "ldhtd", "gan")  # in Table III
SHORT_LINEAR, PIECEWISE = "AR(20)", "piecewise AR [12]"
LINEAR_LEVEL = "free_run_ar.level_error_db"
SILENCE = "references.zero.mae_scaled"
FAILED = 0.98  # of silence's error, from which on a network has learned nothing


def listed(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def machine(name: str) -> str:
    """Sentence on what the costs in a CSV were measured on."""
    machines = {row["machine"] for row in data.csv_rows(name) if row.get("machine")}
    return f"Measured on: {', '.join(sorted(machines))}." if machines else ""


def quicker() -> str:
    """Sentences on which compared systems are quicker than the paper's network, in a step and in an epoch, on a CPU and a GPU.

    And on how many models take longer on a GPU than on a CPU.
    """
    cpu, gpu = ({row["model"]: row for row in data.csv_rows(name)} for name in ("efficiency", "efficiency-gpu"))
    step, epoch = "PyTorch, mean [µs]", "epoch in PyTorch alone [s]"

    def those(times: Mapping[str, Mapping[str, str]], of: str) -> str:
        limit = QUICKER * float(times["foten"][of])
        quick = [SYSTEM_NAMES[key] for key in COMPARED if times[key][of] != "–" and float(times[key][of]) < limit]
        *first, last = quick or ["none"]
        return f"{', '.join(first)} and {last}" if first else last

    def slower(of: str, on_gpu: str) -> str:
        pairs = [(float(cpu[key][of]), float(row[on_gpu])) for key, row in gpu.items() if row[on_gpu] != "–"]
        return f"{sum(a < b for a, b in pairs)} of {len(pairs)}"

    return (
        "In the paper no compared system is quicker than FoTEN, in a step or in an epoch. Here, in PyTorch, quicker in a step: "
        f"{those(cpu, step)}; in an epoch: {those(cpu, epoch)}. On a GPU in a step: {those(gpu, 'step, mean [µs]')}; in an "
        f"epoch: {those(gpu, 'epoch [s]')}. What differs by less than {100 * (1 - QUICKER):.0f} % is not counted. Longer on the "
        f"GPU than on the CPU take a step for {slower(step, 'step, mean [µs]')} and an epoch for {slower(epoch, 'epoch [s]')} "
        "models that were measured on both."
    )


def so_far() -> str:
    """How much of Table I is done."""
    planned = len(read_experiment(experiment_path("table-1")).textures)
    done = {recipe: len(data.textures_of(data.of_all_systems(recipe))) for recipe in data.TABLE_1}
    parts = [f"{n} of {planned} textures by {recipe} recipes" for recipe, n in done.items() if n < planned]
    return f"Done so far: {'; '.join(parts)}." if parts else f"All {planned} textures have both recipes."


ON_A_PAR = {
    "as tuned": ("", ""),
    "both with FoTEN's window": (", FoTEN's window", ""),
    "both with DSTN's window": ("", ", DSTN's window"),
    "both of FoTEN's size": (", FoTEN's size", ""),
    "both of DSTN's size": ("", ", DSTN's size"),
    "both with FoTEN's loss": (", FoTEN's loss", ""),
    "both with twice the epochs": (", twice the epochs", ", twice the epochs"),
}
"""Changes to DSTN and to FoTEN that take one difference between the two away, by what they are then."""


def difference_explained() -> str:
    """Sentence on DSTN's lead over FoTEN in one step, as tuned and with one difference less between the two."""
    changed = data.runs_of("table-1-changed")
    methods = by_place([*data.runs_of("table-1-tuned"), *changed])
    places = sorted({(record["texture"], record["split"]) for record in changed})
    parts = []
    for name, changes in ON_A_PAR.items():
        pair = [
            methods.get(system + change, {}) for system, change in zip(("DSTN [15]", "FoTEN"), changes, strict=True)
        ]
        if not places or any(place not in runs for runs in pair for place in places):
            return ""
        ahead, behind = ([runs[place][ONE_STEP] for place in places] for runs in pair)
        lead = np.subtract(behind, ahead)
        parts.append(f"{name} {lead.mean():.3f} ({np.sum(lead > 0)})")
    return (
        f"DSTN's lead over FoTEN in one step [sd], mean over the {len(places)} textures, and on how many it is ahead: "
        f"{', '.join(parts)}."
    )


def of_table_1() -> str:
    """Sentences on Table I, but for those on recipes, which stand in a table."""
    return listed(line for line in findings(data.table_1()) if BY_RECIPE not in line)


def errors_of(records: Records) -> tuple[list[str], list[Row]]:
    """Textures, and rows of one-step errors of references and of systems, each once."""
    return rows_of([record for record in records if not record["method"].endswith(EXCITED)], "mae")


def beside(reference: str, records: Records) -> dict[str, tuple[float, str, str]]:
    """Errors of one step beside a linear predictor's, by system: ratio, number of textures below, p after Holm over systems."""
    textures, rows = errors_of(records)
    linear = next((row for row in rows if row.name == reference), None)
    if linear is None:
        return {}
    systems = complete(rows, textures)
    p, cells = signed_rank(linear, systems, textures), {}
    for row in systems:
        ratios = row.means(textures) / linear.means(textures)
        below = f"{np.sum(ratios < 1)} of {ratios.size}"
        cells[row.name.removesuffix(WITHOUT)] = (float(ratios.mean()), below, f"{p[row.name]:.3f}" if p else "–")
    return cells


def beside_short_ar() -> str:
    """Sentence on where systems are below AR(20), which sees as many samples as the paper's network."""
    parts = []
    recipes = ("by the paper's recipe or its own", "by the tuned one")
    for recipe, side in zip(recipes, data.of_sides(data.by_both() or data.table_1()), strict=True):
        groups: dict[tuple[str, str], list[str]] = {}
        for system, (_, *on) in beside(SHORT_LINEAR, side).items():
            groups.setdefault((on[0], on[1]), []).append(system)
        counts = [f"{below} for {', '.join(systems)} (p {p})" for (below, p), systems in groups.items()]
        parts += [f"{recipe}: {', '.join(counts)}"] if counts else []
    first = "AR(20) sees 20 samples, as FoTEN does; best AR may see 240. Textures on which a system is below AR(20),"
    return f"{first} {'; '.join(parts)}." if parts else ""


def neighbours(records: Records) -> str:
    """Sentence on what chance may have done to the order of systems by their errors of one step."""
    textures, rows = errors_of(records)
    systems = sorted(complete(rows, textures), key=lambda row: float(row.means(textures).mean()))
    p = [value for row, behind in pairwise(systems) for value in signed_rank(row, [behind], textures).values()]
    if not p:  # fewer than six textures
        return ""
    pairs = []
    for (first, second), value in zip(pairwise(systems), holm(np.array(p)), strict=True):
        ahead = np.concatenate([first.values[texture] < second.values[texture] for texture in textures])
        pairs.append(f"{first.name} is ahead of {second.name} on {ahead.sum()} (p {value:.3f})")
    return (
        f"Neighbours in one step, best first, on {ahead.size} recordings of {len(textures)} textures; p of the textures' means, "
        f"after Holm for {len(p)} pairs: {'; '.join(pairs).replace(WITHOUT, '')}."
    )


def ahead_of(model: str, records: Records) -> str:
    """Sentence on how many textures each other method's error of one step is below that of a model on, with p."""
    textures, rows = errors_of(records)
    own, *others = sorted(complete(rows, textures), key=lambda row: row.model != model)
    p = signed_rank(own, others, textures)
    counts = ", ".join(
        f"{row.name.removesuffix(WITHOUT)} {np.sum(row.means(textures) < own.means(textures))}"
        + (f" (p {p[row.name]:.3f})" if row.name in p else "")
        for row in others
    )
    of_p = " (p of the difference)" if p else ""
    return f"Of {len(textures)} textures, the one-step error is below that of {own.name} on{of_p}: {counts}."


def on_contact() -> str:
    """Sentences on contact mechanics: where others are ahead of ours in one step, with p, and the best of each figure."""
    if not (shown := chosen(data.tuned_on(data.CONTACT))):
        return ""
    lines = [
        line for line in findings(shown) if line.startswith(("one-step MAE", "free-run")) and "none of" not in line
    ]
    return listed((ahead_of(OURS, shown), *lines))


def on_real() -> str:
    """Sentences on which splits of the real recordings are compared, and which of them are the same blocks."""
    records, shared = data.records_of(data.REAL_TABLE_1), data.tuned_on(data.REAL_TABLE_1)
    n, of = (len({(record["texture"], record["split"]) for record in some}) for some in (shared, records))
    return " ".join([f"Means over the {n} of {of} splits that all systems have.", *same_blocks(shared)]) if n else ""


def near_neighbours() -> str:
    """Sentences on the order of near systems: of textures with three recordings, and with the others, which have one."""
    if not (shown := data.near()):
        return ""
    methods, textures = ({record[key] for record in shown} for key in ("method", "texture"))
    single = [r for r in data.runs_of("table-1-tuned") if r["method"] in methods and r["texture"] not in textures]
    of_all = [*shown, *data.with_all(single, methods)]
    return listed(neighbours(records) for records in ((shown, of_all) if len(of_all) > len(shown) else (shown,)))


def of_table_2() -> str:
    """Sentences on the variants: where they are ahead of the network in one step, with p, and their order."""
    if not (records := data.table_2()):
        return ""
    lines = [line for line in findings(records) if line.startswith(("one-step", "By one-step error"))]
    return listed((ahead_of("foten", records), *lines, *failed(records))).replace(WITHOUT, "")


def failed(records: Records) -> list[str]:
    """Sentences on trainings that predict no better than silence, and on the figures of the textures without one."""
    fails = [record for record in records if record[ONE_STEP] > FAILED * record[SILENCE]]
    if not fails:
        return []
    textures = data.textures_of(fails)
    rest = [record for record in records if record["texture"] not in textures]
    figures = (
        f"{name} {mean_of([*of.values()], ONE_STEP)}, {100 * (mean_of([*of.values()], 'one_step.gfc').value or 0.0):.1f} %"
        for name, of in by_place(rest).items()
    )
    runs = ", ".join(f"{record['method']} on {record['texture']}" for record in fails)
    return [
        f"Within {100 * (1 - FAILED):.0f} % of silence's one-step error, or above: {runs}.",
        f"Without {' and '.join(sorted(textures))}: {ahead_of('foten', rest)} MAE [sd] and GFC: {'; '.join(figures)}.",
    ]


def grid_so_far() -> str:
    """How much of the grid is done."""
    records, missing = data.of_grid()
    done = ", ".join(sorted(data.textures_of(records))) or "no texture"
    return f"Done so far: {done}; not yet: {', '.join(missing)}." if missing else f"Means over {done}."


def of_the_grid() -> str:
    """Sentences on the grid: its best cell by validation, windows and losses, and what one change of the recipe does."""
    cells, rows = data.by_cell()
    if not cells:
        return ""

    def error(records: Records, path: str = ONE_STEP) -> float:
        return mean_of(records, path).value or 0.0

    def ratios(of: Mapping[str, Records], to: Records) -> str:
        """Ratios of errors to others of the same textures, in their order, and how many are below 1."""
        texts = []
        for name, records in of.items():
            ratio = np.array([record[ONE_STEP] for record in records]) / [record[ONE_STEP] for record in to]
            texts.append(f"{name} {ratio.mean():.3f} ({np.sum(ratio < 1)} of {ratio.size})")
        return ", ".join(texts)

    def joined(part: int, name: int | str) -> list[Record]:
        return [record for cell in sorted(cells) if cell[part] == name for record in data.in_textures(cells[cell])]

    (window, loss), seeds = (
        min(cells, key=lambda cell: error(cells[cell], VALIDATION[0])),
        [*map(error, data.of_seeds())],
    )
    paper_window, paper_loss = data.PAPER_CELL
    windows, losses = ({cell[part] for cell in cells} - {data.PAPER_CELL[part]} for part in (0, 1))
    other_losses = {str(name): joined(1, name) for name in sorted(losses)}
    other_windows = {f"{name} samples": joined(0, name) for name in sorted(windows)}
    changes = {
        name.removeprefix("1.6, "): data.in_textures(runs) for name, runs in rows.items() if name.startswith("1.6, ")
    }
    return listed(
        (
            f"Best on validation: {window} samples and loss {loss}, with {error(cells[window, loss]):.4f} on test. The paper's "
            f"best, {paper_window} samples and loss {paper_loss} with δ = 1.6, has {error(cells[data.PAPER_CELL]):.4f}; its "
            f"{len(seeds)} seeds range from {min(seeds):.4f} to {max(seeds):.4f}.",
            f"Error ÷ that of the loss {paper_loss} on the same textures with the same windows, and how many are below: "
            f"{ratios(other_losses, joined(1, paper_loss))}.",
            f"Error ÷ that of {paper_window} samples with the same losses: "
            f"{ratios(other_windows, joined(0, paper_window))}.",
            f"Error ÷ that of the paper's best with δ = 1.6: {ratios(changes, data.in_textures(rows['1.6']))}.",
        )
    )


def ours_over_others(records: Records, path: str) -> dict[str, list[Record]]:
    """A figure of foten-plus over that of each other system, as records of `texture` and `ratio`."""
    methods = by_place(records)
    ours = next(name for name in methods if name.startswith(OURS))
    return {name: paired(methods[ours], of, path) for name, of in methods.items() if name != ours}


def interval(records: Records, over: str, under: str = "") -> str:
    """Student's interval of 95 % of a mean over textures."""
    ratio, n = over_textures(records, over, under), len(by_texture(records, over, under))
    mean, reach = ratio.value or 0.0, student_quantile(n) * (np.nan if ratio.error is None else ratio.error)
    return f"{mean - reach:.2f} to {mean + reach:.2f}"


def levels() -> str:
    """Sentences on silent free runs of the network, and on level errors of it, of linear predictors and of ours."""
    papers, tuned = (
        [one for one in side if one["method"] == data.VARIANTS["foten"]] for side in data.of_sides(data.by_both())
    )
    silent, by_papers = (sum(one["warm_start.stored.level_db"] < SILENT_DB for one in side) for side in (tuned, papers))
    methods = {name: [*of.values()] for name, of in by_place(chosen(data.by_both())).items()}
    errors = (
        ("FoTEN, tuned,", tuned, "free_run_deterministic.level_error_db"),
        ("AR(20), whose noise is constant,", tuned, LINEAR_LEVEL),
        ("piecewise AR", methods[PIECEWISE], LEVEL),
        ("FoTEN with our excitation", methods[f"FoTEN {EXCITED}"], LEVEL),
        (OURS, methods[f"{OURS} (ours)"], LEVEL),
        ("a second realisation", tuned, "ceiling.level_error_db"),
    )
    return (
        f"FoTEN has no random part, and its free run is silent ({-SILENT_DB:.0f} dB or more below the recording) on {silent} of "
        f"{len(tuned)} simulated textures by its tuned recipe, on {by_papers} by the paper's. Level errors there [dB]: "
        f"{'; '.join(f'{name} {mean_of(runs, path, digits=1)}' for name, runs, path in errors)}."
    )


def beside_dstn() -> list[str]:
    """Sentences on our error of one step over DSTN's: an interval, and which textures carry the mean."""
    both = (ours_over_others(chosen(data.EQUAL[MAIN[name]]()), ONE_STEP) for name in (data.SIMULATED, data.CONTACT))
    simulated, contact = (ratios["DSTN [15]"] for ratios in both)
    ordered = sorted(((one["ratio"], one["texture"]) for one in contact), reverse=True)
    percents, names = np.array([100 * (ratio - 1) for ratio, _ in ordered]), [name for _, name in ordered[:3]]
    return [
        f"One step ÷ DSTN's on simulated textures: {interval(simulated, 'ratio')} (95 %, n = {len(simulated)}).",
        f"On contact mechanics, the one-step error of {OURS} is {percents.mean():.0f} % above DSTN's, a mean of ratios whose "
        f"median is {np.median(percents):.0f} %; {', '.join(names)} carry it: without them it is {percents[3:].mean():.0f} %.",
    ]


def seconds_of_test(name: str) -> str:
    """Sentence on how many seconds of test blocks the figures of real recordings rest on."""
    blocks: dict[str, set[object]] = {}
    if name == data.REAL_TABLE_1:  # one block for each split; silence's error tells two apart
        for record in data.records_of(name):
            blocks.setdefault(record["texture"], set()).add(record[SILENCE])
    for row in () if blocks else data.csv_rows("limits"):
        blocks.setdefault(row["texture"], set()).update(row["test blocks"].split())
    split_seeds, block_s = data.of_file(name)["split_seeds"], data.of_file(name)["preprocess"]["block_ms"] / 1000
    low, *_, high = sorted(block_s * len(numbers) for numbers in blocks.values())
    in_all = (
        f"The test blocks of a real recording hold {low:.1f} to {high:.1f} s in all, "
        f"{block_s * data.records_of(name)[0]['n_blocks']:.1f} s in each of {len(split_seeds)} splits, which share them."
    )
    shares = []
    for one in (data.REAL_10, data.REAL_2_5) if name == data.REAL_10 else (name,):
        rate = data.of_file(one)["preprocess"]["rate_hz"]
        share = 1 - first_scored(round(block_s * rate)) / (block_s * rate)
        shares.append(f"{100 * share:.0f} % at {rate / 1000:g} kHz")
    return f"{in_all} One step is scored on part of each: {', '.join(shares)}."


def real_intervals() -> str:
    """Sentence on ours beside linear predictors on real recordings."""
    ours = [record for record in chosen(data.tuned_on(data.REAL_TABLE_1)) if record["model"] == OURS]
    return (
        f"{OURS} beside linear predictors (95 %, n = {len(data.textures_of(ours))}): one step ÷ best AR "
        f"{interval(ours, ONE_STEP, BEST_AR)}, LSD ÷ AR(20) {interval(ours, LSD, AR_LSD)}, level error ÷ AR(20) "
        f"{interval(ours, LEVEL, LINEAR_LEVEL)}."
    )
