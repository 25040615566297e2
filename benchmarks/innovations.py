"""What is left to chance: how likely the innovations of validation blocks are under four distributions fitted on training blocks.

    python benchmarks/innovations.py TEXTURE.foten... --recordings DIR [--save FILE] [--page docs/fidelity.md]

Innovations of the lattice over the scale that the texture gives them at their speed and force, less what the network adds where
it is in the loop. A Gaussian, a Student t, two Gaussians about zero, and z·exp(h z²/2) of a Gaussian z, which is rendered; each
with a constant scale and shape. Mean negative log-likelihood [nat], less that of the Gaussian: below zero is likelier. Textures
that are rendered with tones are left out, since their excitation belongs to what the tones leave.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import optimize, stats

from foten.atomic_write import atomic_write
from foten.dsp.noise import gaussianised
from foten.families.conditions import FADE_FORCE, FADE_SPEED
from foten.families.texture_file import Texture, read_texture
from foten.recording.preprocess import preprocess
from foten.recording.split import Split
from foten.runtime.loops import predict_blocks
from foten.runtime.native import NativeTexture
from main_table import SOURCES, between, name_of, recording_of

Array = np.ndarray


def normal(u: Array, log_scale: float) -> Array:
    return stats.norm.logpdf(u, scale=np.exp(log_scale))


def student(u: Array, log_scale: float, log_freedom: float) -> Array:
    return stats.t.logpdf(u, 2 + np.exp(log_freedom), scale=np.exp(log_scale))


def two_normals(u: Array, log_scale: float, log_wider: float, logit: float) -> Array:
    share, wider = 1 / (1 + np.exp(-logit)), np.exp(log_scale) * (1 + np.exp(log_wider))
    return np.logaddexp(
        np.log1p(-share) + stats.norm.logpdf(u, scale=np.exp(log_scale)),
        np.log(share) + stats.norm.logpdf(u, scale=wider),
    )


def heavy(u: Array, log_scale: float, log_h: float) -> Array:
    """Return the density of z·exp(h z²/2): that of z, over the derivative exp(h z²/2)(1 + h z²)."""
    h = np.exp(min(log_h, 2.0))
    z = gaussianised(u / np.exp(log_scale), np.full(u.shape, h))
    return stats.norm.logpdf(z) - 0.5 * h * z * z - np.log1p(h * z * z) - log_scale


KINDS = {
    "Gaussian": (normal, (0.0,)),
    "Student t": (student, (-0.2, 1.0)),
    "two Gaussians": (two_normals, (-0.3, 0.0, -1.5)),
    "z·exp(h z²/2)": (heavy, (-0.2, -2.0)),
}


def judge(texture: Texture, recordings: Path) -> dict[str, float]:
    """Return the mean negative log-likelihood [nat] of each distribution."""
    rate, seed = texture.rate_hz, int(texture.card["training"]["seed"])
    recording, config = recording_of(texture.card["texture"], rate, seed, recordings)
    trace, split = preprocess(recording, config), Split.from_fields(texture.card["split"])
    samples = texture.scaling.scale(trace.stacked()).reshape(trace.n_blocks, trace.block, 3)
    kernel = NativeTexture(texture.to_bytes())
    asked = slice(texture.window, None)
    moving = (trace.blocks(trace.speed) >= FADE_SPEED) & (trace.blocks(trace.force) >= FADE_FORCE)

    def of(blocks: tuple[int, ...]) -> Array:
        chosen = list(blocks)
        some = samples[chosen]
        predicted = predict_blocks(kernel, some, "rendering")
        u = (some[:, asked, 0] - predicted.sample) / predicted.scale
        return np.asarray(u[moving[chosen][:, asked]])

    train, validation = of(split.train), of(split.validation)
    nats = {}
    for name, (density, start) in KINDS.items():
        fitted = optimize.minimize(
            lambda parameters, density=density: -float(density(train, *parameters).mean()),
            start,
            method="Nelder-Mead",
            options={"maxiter": 400, "xatol": 1e-3, "fatol": 1e-5},
        )
        nats[name] = -float(density(validation, *fitted.x).mean())
    return nats


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("textures", nargs="*", type=Path)
    parser.add_argument("--recordings", type=Path, default=Path("recordings"))
    parser.add_argument("--save", type=Path, metavar="FILE", help="keep the figures as JSON there")
    parser.add_argument("--page", type=Path, metavar="FILE", help="put the table between its markers there")
    arguments = parser.parse_args()
    lines = ["| texture | Gaussian [nat] | " + " | ".join(list(KINDS)[1:]) + " |", "|" + "---|" * 5]
    results = []
    for path in arguments.textures:
        texture = read_texture(path)
        if texture.sizes.n_tones:
            print(f"{path.name}: left out, it is rendered with tones", file=sys.stderr)
            continue
        nats = judge(texture, arguments.recordings)
        about = {"file": path.stem, "rate_hz": texture.rate_hz, "source_sha256": SOURCES}
        results.append({**about, "nats": nats})
        gains = [f"{nats[name] - nats['Gaussian']:+.3f}" for name in list(KINDS)[1:]]
        lines.append(f"| {name_of(about, '')} | {nats['Gaussian']:.3f} | {' | '.join(gains)} |")
        print(f"{path.stem}: {nats}", file=sys.stderr, flush=True)
    if arguments.save is not None:
        with atomic_write(arguments.save) as part:
            part.write_text(json.dumps(results, indent=1) + "\n")
    between(arguments.page, "innovations", "\n".join(lines))


if __name__ == "__main__":
    main()
