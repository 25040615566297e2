"""Pictures of figures in docs/results and of result files: ceilings, limits, abrupt changes, listeners, Fig. 5 to 7."""

import argparse
import re
from itertools import chain
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from csv_records import (
    AR_LSD,
    LSD,
    ONE_STEP,
    PAPER_CELL,
    REAL,
    by_cell,
    csv_rows,
    numbers,
    of_seeds,
    records_of,
    rows_with,
    runs,
)
from csv_records import OURS as OURS_KEY
from drawing import CEILING, INK, LINEAR, OURS, PAPER, STYLE, drawn, image_of, legend_of
from foten.dsp.inference import standard_error
from foten.reporting.figure import add_legend
from foten.reporting.table import mean_number
from foten.simulation.contact_mechanics import CONTACT
from foten.simulation.linear_family import LINEAR_FAMILY
from foten.simulation.simulate import TEXTURES
from foten_lab import figures
from foten_lab.aggregate import by_texture
from foten_lab.experiment import experiment_path, read_experiment
from foten_lab.results import VALIDATION, chosen_results, read_results

COMPARED = ("steel-mesh-1", "cardboard", "towel")  # of the twelve of Table I


def ceiling(arguments: argparse.Namespace) -> Figure:
    """Log-spectral distances of every texture, beside that of a realisation of the same stroke."""
    records = [*runs("main-simulated"), *runs("main-real-10khz")]
    keys = [key for key in (*TEXTURES, *REAL) if any(record["texture"] == key for record in records)]
    rows = {
        "AR(20) with white noise": ("free_run_ar", LINEAR, "s"),
        "foten-plus": ("free_run", OURS, "o"),
        "ceiling": ("ceiling", CEILING, "|"),
    }
    figure, panels = drawn(9, 5, 1, 2, sharey=True)
    for axes, key, title in ((panels[0], "lsd_db", "block by block"), (panels[1], "lsd_long_db", "all blocks pooled")):
        for name, (run, colour, mark) in rows.items():
            values = [np.mean([r[f"{run}.{key}"] for r in records if r["texture"] == k]) for k in keys]
            size = 14 if mark == "|" else 6
            axes.plot(values, range(len(keys)), mark, color=colour, label=name, markersize=size, markeredgewidth=2)
        axes.set(xlabel="log-spectral distance [dB]", title=title, xlim=(0, None))
        axes.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(keys)), keys)
    panels[0].invert_yaxis()
    add_legend(panels[1], STYLE)
    return figure


def limits(arguments: argparse.Namespace) -> Figure:
    """How near the real four a signal can come at all."""
    rows = csv_rows("limits")
    anchor, *others = list(rows[0])[3:]
    of_texture = [rows_with(rows, texture=texture) for texture in REAL]
    groups = {name: [numbers(of, name) / numbers(of, anchor) for of in of_texture] for name in (anchor, *others)}
    if ours := runs("main-real-10khz"):
        groups[OURS_KEY] = [*by_texture(ours, LSD, AR_LSD).values()]
    means = {name: mean_number(splits, 2) for name, splits in groups.items()}
    order = sorted(means, key=lambda name: means[name].value)
    values, errors = [means[name].value for name in order], [means[name].error for name in order]
    figure, axes = drawn(8, 3.6)
    colours = {anchor: LINEAR, OURS_KEY: OURS, "the known blocks themselves": CEILING}
    bars = {"color": [colours.get(name, "#bbbbbb") for name in order], "xerr": errors}
    axes.barh(order, values, **bars, error_kw={"ecolor": INK, "elinewidth": 0.8, "capsize": 2})
    for i, (value, error) in enumerate(zip(values, errors, strict=True)):
        axes.text(value + error + 0.015, i, f"{value:.2f}", va="center", fontsize=8)
    axes.set(
        xlabel="log-spectral distance to the test blocks ÷ that of AR(20)\n"
        "mean of four real recordings at 10 kHz, its standard error",
        xlim=(0, 1.35),
    )
    axes.xaxis.label.set_size(8)
    return figure


def outside(arguments: argparse.Namespace) -> Figure:
    """Level errors above the trained range, towards rest and after jumps."""
    rows = csv_rows("outside")
    regions = list(dict.fromkeys(row["where"] for row in rows))
    figure, axes = drawn(8, 3.2)
    for i, (policy, colour) in enumerate((("clamp", PAPER), ("fade", "#bbbbbb"), ("grow", OURS))):
        errors = [numbers(rows_with(rows, policy=policy, where=region), "level_error_db") for region in regions]
        at = np.arange(len(regions)) + 0.27 * (i - 1)
        spread = [standard_error(row) for row in errors]
        axes.bar(at, [np.mean(row) for row in errors], 0.25, color=colour, label=policy, yerr=spread, capsize=2)
    n = len({row["texture"] for row in rows})
    axes.set(ylabel="level error [dB]", title=f"Trained to half the range, mean of {n} textures")
    axes.set_xticks(range(len(regions)), regions, fontsize=8)
    add_legend(axes, STYLE)
    return figure


def abrupt(arguments: argparse.Namespace) -> Figure:
    """Levels around four abrupt changes on a surface of two masses, of the truth and of renderings."""
    rows = rows_with(csv_rows("abrupt"), surface="sandstone")
    shown = ("speed 40 → 200 mm/s", "reversal at 120 mm/s", "force 0.5 → 2 N", "tap of 1.5 N at 80 mm/s")
    levels = next(name for name in rows[0] if name.startswith("levels from"))
    ms = re.fullmatch(r"levels from (-?\d+) ms, each (\d+) ms \[dB\]", levels)
    assert ms is not None
    first, each = map(float, ms.groups())
    lines = {
        "truth": ("second realisation", INK, "-"),
        "its flat surface": ("flat surface", INK, ":"),
        "foten-plus": ("foten-plus", OURS, "-"),
        "foten": ("foten", PAPER, "-"),
    }
    figure, panels = drawn(9, 2.8, 1, 4, sharey=True)
    for axes, change in zip(panels, shown, strict=True):
        for name, (rendering, colour, dashes) in lines.items():
            some = rows_with(rows, change=change, rendering=rendering)
            values = [float(value) for row in some for value in row[levels].split()]
            at = first + each * (np.arange(len(values)) + 0.5)  # the middle of a frame
            axes.plot(at, values, color=colour, ls=dashes, label=name)
        axes.axvline(0.0, color="#cccccc", lw=0.8, zorder=0)
        axes.set_title(change, loc="left", fontsize=9)
        axes.set(xlim=(-50, 250), xlabel="ms")
    panels[0].set_ylabel("level [dB]")
    legend_of(figure, panels[0], ncols=4, loc="outside upper right")
    return figure


def listener(arguments: argparse.Namespace) -> Figure:
    """The area under a listener's curve, by texture, and that of the control."""
    auc = {
        row["texture"]: [float(row[f"listener.{key}"]) for key in ("listener_auc", "listener_auc_control")]
        for row in records_of("listener")
    }
    kinds = (LINEAR_FAMILY, TEXTURES, CONTACT)
    figure, panels = drawn(9, 3.6, 1, 3, sharey=True, width_ratios=[len(kind) + 1 for kind in kinds])
    for axes, kind, title in zip(panels, kinds, ("linear", "simulated", "contact mechanics"), strict=True):
        order = sorted((key for key in kind if key in auc), key=lambda key: auc[key][0])
        ours, control = zip(*(auc[key] for key in order), strict=True)
        axes.plot(range(len(order)), ours, "o", color=OURS, label="foten-plus", ms=6)
        axes.plot(range(len(order)), control, "_", color=INK, ms=11, label="control")
        axes.axhline(0.5, color="#cccccc", lw=0.8, zorder=0)
        axes.set_xticks(range(len(order)), order, rotation=60, ha="right", fontsize=8)
        axes.set_title(title, loc="left", fontsize=10)
        axes.set(xlim=(-0.6, len(order) - 0.4), ylim=(0.4, 1.02))
    panels[0].set_ylabel("AUC of the listener")
    legend_of(figure, panels[2], ncols=4, loc="outside upper right")
    return figure


def lengths(arguments: argparse.Namespace) -> Figure:
    """The ideal listener's area by seconds learned from: of the default now and before, and of each random part alone."""
    names = {
        "before recorded innovations": (PAPER, "-"),
        "as by default": (OURS, "-"),
        "recorded alone": (OURS, ":"),
        "noise alone": (LINEAR, ":"),
    }
    areas: dict[tuple[str, bool], dict[float, list[float]]] = {}
    for row in csv_rows("trials"):
        name, _, length = row["approach"].partition(", ")
        if name in names and length.endswith(" s"):
            of = areas.setdefault((name, row["surface"].startswith("linear-")), {})
            of.setdefault(float(length.removesuffix(" s")), []).append(float(row["ideal"]))
    figure, panels = drawn(6.4, 2.5, 1, 2, sharey=True)
    for axes, linear, title in zip(panels, (False, True), ("glitter paper, wood", "a linear process"), strict=True):
        for name, (colour, style) in names.items():
            known = sorted(areas.get((name, linear), {}).items())
            axes.plot(*zip(*((s, np.mean(each)) for s, each in known), strict=True), style, color=colour, label=name)
        axes.set_xscale("log", base=2)
        axes.set_xticks([8, 16, 32, 64, 256], ["8", "16", "32", "64", "256"])
        axes.set_title(title, loc="left", fontsize=10)
        axes.axhline(0.5, color="#cccccc", lw=0.8, zorder=0)
    panels[0].set(ylabel="AUC of the listener", xlabel="s learned from")
    add_legend(panels[1], STYLE, fontsize=8)
    return figure


def of_sweeps(arguments: argparse.Namespace) -> list[Any]:
    """Results of Table I by several recipes, of each system those of the recipe that validation chose."""
    results = [
        {**result, "run": {**result["run"], "recipe": result["experiment"]["title"]}}
        for folder in arguments.sweep
        for result in read_results(folder, mixed=True)
    ]
    order = [method.title for method in read_experiment(experiment_path("table-1-tuned")).methods]
    return sorted(chosen_results(results), key=lambda result: order.index(result["run"]["method"]))


def compared(arguments: argparse.Namespace) -> Figure:
    """Waveforms of each system of Table I in the closed loop, of three textures."""
    shown = [result for result in of_sweeps(arguments) if result["run"]["texture"] in COMPARED]
    return figures.waveforms(shown)


def figure_5(arguments: argparse.Namespace) -> Figure | None:
    """Fig. 5: errors by window and loss, and the range of those of several seeds."""
    errors = {
        (record["texture"], loss, window): np.array([record[path] for path in (ONE_STEP, VALIDATION[0])])
        for (window, loss), records in by_cell()[0].items()
        for record in records
    }
    if not errors:
        print("figure-5: there are no runs in docs/results yet")
        return None
    seeds: dict[tuple[str, int], list[float]] = {}
    for record in chain.from_iterable(of_seeds()):
        seeds.setdefault((record["texture"], PAPER_CELL[0]), []).append(record[ONE_STEP])
    return figures.windows_and_losses(errors, seeds)


def figure_6(arguments: argparse.Namespace) -> Image.Image:
    """Fig. 6, free runs of FoTEN, with an excitation and without, over recordings; below how all systems converge."""
    results = of_sweeps(arguments)
    above = figures.waveforms(results, "foten")
    below = figures.convergence(results)
    below.set_size_inches(above.get_figwidth(), 4.8)
    images = [image_of(above), image_of(below)]
    picture = Image.new("RGB", (images[0].width, sum(image.height for image in images)))
    picture.paste(images[0], (0, 0))
    picture.paste(images[1], (0, images[0].height))
    return picture


def figure_7(arguments: argparse.Namespace) -> Figure:
    """Fig. 7: spectra of the test blocks and of every system's free run."""
    return figures.spectra(of_sweeps(arguments))
