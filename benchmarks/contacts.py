"""How many hands one core holds at once, in each instruction set, and how many deadlines are missed beside an empty loop's.

    python benchmarks/contacts.py [--textures T.foten ...] [--seconds 60] [--csv FILE]

A contact is one state that renders each sample in time, under a hand that moves at each: 1 ms over the median time of a step, at
1 kHz. Then as many independent states as fill 60 % of a millisecond are held for a minute, a second of them and a second of a
loop that is as long and does nothing in turn: what that one misses is the machine's. Last, one state alone at 10 kHz. All of it
for the paper's network, and for foten-plus with a minute of recorded innovations, a tone and an equaliser, both untrained: the
time is the same. The loop, `native/tests/contacts.c`, is built here.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from bench import ROOT, parser_of, report, untrained
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import read_texture
from step import INSTRUCTION_SETS

SHARE = 0.6  # of a millisecond


def built(folder: Path) -> Path:
    """Build the loop with the kernel's own sources and return it."""
    cmake = shutil.which("cmake")
    if cmake is None:
        sys.exit("cmake is missing: pip install cmake")
    source = str(ROOT / "packages" / "foten")
    subprocess.run([cmake, "-S", source, "-B", str(folder), "-DFOTEN_TESTS=ON"], check=True, stdout=subprocess.DEVNULL)
    subprocess.run([cmake, "--build", str(folder), "--target", "contacts"], check=True, stdout=subprocess.DEVNULL)
    return folder / "contacts"


def textures_of(paths: list[Path]) -> list[tuple[Any, Any]]:
    """The textures of files; without any an untrained one of each model, at 1 and at 10 kHz."""
    if paths:
        return [(read_texture(path), None) for path in paths]
    network = untrained("foten")  # conftest can be imported from here on
    from conftest import CARD, recorded

    table = {"n_speed": 12, "n_force": 3}  # lattices and tone as sawn wood gets them
    residual = {"residual_order": 40, **{f"n_residual_{name[2:]}": n for name, n in table.items()}}
    sizes = FotenPlusSizes(order=40, **table, n_tones=1, **residual, equalised=True, recorded=True)
    fast = {"rate_hz": 10_000.0, "preprocess": {**CARD["preprocess"], "rate_hz": 10_000.0}}
    stored = [recorded(n=8000, step=step).tensors() for step in (4, 40)]
    plus = untrained("foten-plus", sizes, stored[0]), untrained("foten-plus", sizes, stored[1], **fast)
    return [(network, untrained("foten", **fast)), plus]


def measured(program: Path, file: Path, isa: str, share: float, seconds: int, tick_us: float) -> dict[str, Any]:
    """What the loop measured in one instruction set."""
    done = subprocess.run(
        [str(program), str(file), f"{share:g}", str(seconds), f"{tick_us:g}"],
        env={**os.environ, "FOTEN_ISA": isa},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        sys.exit(done.stderr.strip())
    return dict(json.loads(done.stdout))


def rows_of(texture: Any, fast: Any, program: Path, file: Path, seconds: int) -> list[list[str]]:
    """Rows of a texture in each instruction set, and of a fast one alone at 10 kHz."""
    file.write_bytes(texture.to_bytes())
    by_isa: dict[str, dict[str, Any]] = {}
    for isa in INSTRUCTION_SETS:
        line = measured(program, file, isa, SHARE, min(10, seconds) if by_isa else seconds, 1000.0)
        if line["isa"] == isa:
            by_isa[isa] = line
    if fast is not None:
        file.write_bytes(fast.to_bytes())
        alone = measured(program, file, next(iter(by_isa)), 0.0, seconds, 100.0)
        by_isa[f"{alone['isa']}, 10 kHz"] = alone
    rows = []
    for isa, line in by_isa.items():
        missed_share, empty_share = line["n_missed"] / line["n_ticks"], line["n_empty_missed"] / line["n_empty_ticks"]
        held = f"{line['n_states']} for {line['n_ticks'] * line['tick_us'] / 1e6:.0f} s"
        shares = [f"{100 * share:.3f} %" for share in (missed_share, empty_share)]
        rows.append([texture.card["model"], isa, f"{line['p50_us']:.1f}", f"{line['contacts']:.1f}", held, *shares])
    return rows


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--textures", nargs="+", type=Path, default=[], metavar="T.foten", help="at 1 kHz")
    parser.add_argument("--seconds", type=int, default=60)
    arguments = parser.parse_args()
    textures = textures_of(arguments.textures)
    for texture, _ in textures:
        if texture.rate_hz != 1000.0:
            parser.error(f"a texture's rate is {texture.rate_hz:g} Hz, expected 1000")
    cells = [["model", "instruction set", "p50 [µs]", "contacts", "states held", "missed", "an empty loop misses"]]
    with tempfile.TemporaryDirectory() as folder:
        program, file = built(Path(folder) / "build"), Path(folder) / "t.foten"
        for texture, fast in textures:
            cells += rows_of(texture, fast, program, file, arguments.seconds)
    report(cells, arguments.csv)


if __name__ == "__main__":
    main()
