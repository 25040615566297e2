"""A seeded generator of hostile files, and a harness that runs the command line on them in child processes.

Small valid files of every format are damaged: bits flipped, ends cut off, pieces moved; or written anew with headers that lie:
sizes beyond any memory, JSON nested 100,000 deep, odd types, numbers that are none, names with escapes, links elsewhere.
"""

from __future__ import annotations

import io
import json
import math
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat, wavfile

from foten.datasets.hdf5 import write_recording
from foten.models.texture_file import Texture
from foten.recording.recording import Channel, Recording

LONGEST_S = 60.0  # of one command, on a busy machine; without one, none takes 5
DEEP = 100_000
RATE_HZ = 1000.0
N = 2200

KINDS = ("texture", "recording", "hdf5", "npz", "csv", "other")
"""What is made in turn; `other` is .npy, .mat, .tdms, .wav, .xlsx, .xml of models or an actuator's profile."""


@dataclass(frozen=True)
class Result:
    """What one command did.

    Attributes:
        arguments: of `foten`.
        status: its exit status; minus a signal's number where it crashed; None where it hung.
        out, err: what it printed.
    """

    arguments: tuple[str, ...]
    status: int | None
    out: str
    err: str

    @property
    def clean(self) -> bool:
        """Whether it did its work, or refused the file in one line, and printed nothing that a terminal would obey."""
        if "Traceback" in self.err or "Warning" in self.err:
            return False
        if not (self.out + self.err).replace("\n", "").isprintable():
            return False
        return self.status == 0 or (self.status == 2 and self.err.count("\n") == 1 and self.err[-1] == "\n")

    def __str__(self) -> str:
        return f"foten {' '.join(self.arguments)}: exit {self.status}\n{self.err[-1500:]}"


class Generator:
    """Hostile files by number: the same number gives the same file."""

    def __init__(self, textures: Sequence[Texture], folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._textures = [texture.to_bytes() for texture in textures]
        rng = np.random.default_rng(0)
        t = np.arange(N) / RATE_HZ
        self._columns = {
            "acceleration": rng.standard_normal(N),
            "speed": 80 + 60 * np.sin(2 * t),
            "force": 1 + 0.4 * np.cos(3 * t),
        }
        self._others = self._valid_others()

    def write(self, number: int, folder: Path) -> tuple[Path, list[list[str]]]:
        """Write a hostile file; return it with the commands that are to read it."""
        rng = random.Random(number)
        kind = KINDS[number % len(KINDS)]
        name = f"{number:04d}"
        out = str(folder / f"{name}-out.h5")
        if kind == "texture":
            path = folder / f"{name}.foten"
            path.write_bytes(self._texture(rng))
            stroke = ["--speed", "80", "--force", "0.8", "--seconds", "0.05"]
            return path, [["info", str(path)], ["render", str(path), *stroke, "-o", str(folder / f"{name}.wav")]]
        if kind == "recording":
            path = folder / f"{name}.h5"
            self._recording(rng, path)
            return path, [["inspect", str(path)]]
        if kind == "other":
            suffix, data = rng.choice(self._others)
            path = folder / f"{name}{suffix}"
            path.write_bytes(damaged(data, rng))
            if suffix == ".json":
                example = folder / "example.foten"
                example.write_bytes(self._textures[0])
                path.write_bytes(rng.choice([damaged, _json_with_hostile_values])(data, rng))
                play = ["--to", "null", "--seconds", "0.02", "--rate", "8000", "--speed", "80", "--force", "1"]
                return path, [["play", str(example), "--actuator", str(path), *play]]
            if suffix == ".xml":
                return path, [["import", str(path), "-o", str(folder / f"{name}-out.foten")]]
        else:
            path = folder / f"{name}.{ {'hdf5': 'h5'}.get(kind, kind) }"
            {"hdf5": self._hdf5, "npz": self._npz, "csv": self._csv}[kind](rng, path)
        mapped = ["--map", "acceleration=0,speed=1,force=2"] if rng.random() < 0.5 else []
        forced = ["--force-units"] if rng.random() < 0.3 else []
        return path, [["import", str(path), "-o", out, "--rate", "1000", *mapped, *forced]]

    def _texture(self, rng: random.Random) -> bytes:
        data = rng.choice(self._textures)
        if rng.random() < 0.3:
            return damaged(data, rng)
        length = struct.unpack("<Q", data[:8])[0]
        header, tensors = json.loads(data[8 : 8 + length]), data[8 + length :]
        card = json.loads(header["__metadata__"]["foten"])
        match rng.randrange(6):
            case 0:
                header["__metadata__"]["foten"] = _deep(rng)
            case 1:
                header["__metadata__"] = hostile_value(rng)
            case 2:
                name = rng.choice([key for key in header if key != "__metadata__"])
                where = rng.choice(["dtype", "shape", "data_offsets"])
                header[name][where] = rng.choice(
                    ["F16", "I64", "BF16", [2**40], [0], [], [0, 2**60], hostile_value(rng)]
                )
            case 3:
                # Sound but for its numbers: what no check of types finds.
                at = rng.randrange(0, len(tensors) - 8) & ~3
                evil = np.frombuffer(rng.randbytes(8), dtype=np.float32)
                worst = np.array(rng.choice([[np.nan, np.inf], [3e38, -3e38], [1e-45, -0.0], evil]), dtype=np.float32)
                tensors = tensors[:at] + worst.tobytes() + tensors[at + 8 :]
            case _:
                for _ in range(rng.randint(1, 3)):
                    _set_somewhere(card, hostile_value(rng), rng)
                header["__metadata__"]["foten"] = json.dumps(card)
        text = _deep(rng).encode() if rng.random() < 0.03 else json.dumps(header).encode()
        return struct.pack("<Q", len(text)) + text + tensors

    def _recording(self, rng: random.Random, path: Path) -> None:
        columns = {name: Channel(samples, RATE_HZ) for name, samples in self._columns.items()}
        times = np.arange(N) / RATE_HZ + 1e-4 * np.sin(np.arange(N))
        columns["position_x"] = Channel(self._columns["speed"], RATE_HZ, times)
        write_recording(Recording(columns, texture="denim", notes="µ"), path)
        if rng.random() < 0.5:
            path.write_bytes(damaged(path.read_bytes(), rng))
            return
        with h5py.File(path, "r+") as file:
            name = f"channels/{rng.choice(list(columns))}"
            match rng.randrange(6):
                case 0:
                    file[name].attrs[rng.choice(["rate_hz", "unit"])] = _attribute(rng)
                case 1:
                    file.attrs[rng.choice(["format", "version", "texture", "history"])] = _attribute(rng)
                case 2:
                    file.attrs["simulation"] = rng.choice([_deep(rng)[:60_000], "[]", "{", '{"parameters": 3}', "NaN"])
                case 3:
                    samples = file[name][()]
                    samples[rng.randrange(N)] = rng.choice([np.nan, np.inf, 1e300, 1e30, -1e12, 5e-324])
                    file[name][()] = samples
                case 4:
                    file["times_s/position_x"][rng.randrange(N)] = rng.choice([np.nan, 1e300, -1e300, 0.0, 5e9])
                case _:
                    attributes = dict(file[name].attrs)
                    del file[name]
                    _odd_dataset(file, name, rng)
                    if isinstance(file.get(name, getlink=True), h5py.HardLink):
                        file[name].attrs.update(attributes)

    def _hdf5(self, rng: random.Random, path: Path) -> None:
        with h5py.File(path, "w") as file:
            for name, samples in self._columns.items():
                file.create_dataset(name, data=samples, chunks=(500,), compression="gzip", compression_opts=1)
                file[name].attrs["unit"] = rng.choice(["", "m/s^2", "mm/s", "N", "\x1b[2J", "furlong"])
            if rng.random() < 0.6:
                _odd_dataset(file, rng.choice(["a/b/c", "odd", "acc_x", "x\n\x1b[31m", "time", "é" * 300]), rng)
        if rng.random() < 0.6:
            path.write_bytes(damaged(path.read_bytes(), rng))

    def _npz(self, rng: random.Random, path: Path) -> None:
        compression = rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
        with zipfile.ZipFile(path, "w", compression) as archive:
            for name, samples in self._columns.items():
                buffer = io.BytesIO()
                np.save(buffer, samples)
                archive.writestr(zipfile.ZipInfo(f"{name}.npy"), buffer.getvalue(), compression)
            if rng.random() < 0.7:
                name = rng.choice(["x.npy", ".npy", "../../x.npy", "a\n\x1b[31m.npy", "x", "0"])
                archive.writestr(zipfile.ZipInfo(name), _npy(rng), compression)
        if rng.random() < 0.4:
            path.write_bytes(damaged(path.read_bytes(), rng))

    def _csv(self, rng: random.Random, path: Path) -> None:
        names = list(self._columns)
        rows = [[repr(float(value)) for value in row] for row in zip(*self._columns.values(), strict=True)]
        rows = [names, *(rows if rng.random() < 0.5 else rows[:50])]
        for _ in range(rng.choice([0, 1, 1, 3])):
            row = rng.randrange(0, len(rows)) if rng.random() < 0.5 else rng.randrange(0, 3)
            rows[row][rng.randrange(len(rows[row]))] = rng.choice(_CELLS)
        if rng.random() < 0.3:
            column = rng.randrange(3)
            for row in rows[1:]:
                row[column] = rng.choice(_CELLS) if rng.random() < 0.2 else str(1e308 * rng.random())
        if rng.random() < 0.2:
            rows.insert(1, [rng.choice(["s", "lbf", "[kg]", "furlong", "-", "", "(", "[", "µ"]) for _ in names])
        mark = rng.choice([",", ",", ";", "\t", " "])
        text = "\n".join(mark.join(row) for row in rows)
        data = text.encode(rng.choice(["utf-8", "utf-8", "latin-1", "utf-16"]), errors="replace")
        path.write_bytes(damaged(data, rng) if rng.random() < 0.4 else data)

    def _valid_others(self) -> list[tuple[str, bytes]]:
        stem = self._folder / "valid"
        table = np.stack(list(self._columns.values()), axis=1)
        np.save(f"{stem}.npy", table)
        savemat(f"{stem}.mat", {"trial": {**self._columns, "unit": "N"}, "fs": 1000.0}, do_compression=True)
        with h5py.File(f"{stem}73.mat", "w", userblock_size=512) as file:
            for name, samples in self._columns.items():
                file[name] = samples[:, None]
                file[name].attrs["MATLAB_class"] = np.bytes_("double")
        with open(f"{stem}73.mat", "r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
        with TdmsWriter(f"{stem}.tdms") as writer:
            waveform = {"wf_increment": 0.001, "unit_string": "N"}
            writer.write_segment(
                [ChannelObject("rig", name, s, properties=waveform) for name, s in self._columns.items()]
            )
        wavfile.write(f"{stem}.wav", 1000, table.astype(np.float32))
        book = openpyxl.Workbook()
        book.active.append(list(self._columns))
        for row in table[:60].tolist():
            book.active.append(row)
        book.save(f"{stem}.xlsx")
        corners = [(0, 0), (100, 0), (0, 2), (100, 2)]
        models = "".join(
            f"<model><ARcoeff><value>1</value><value>-0.5</value></ARcoeff><var>0.1</var>"
            f"<speedMod>{speed}</speedMod><forceMod>{force}</forceMod></model>"
            for speed, force in corners
        )
        xml = f"<modelSet><SampleRate>10000</SampleRate><numMod>4</numMod>{models}<tri>1,2,3</tri><tri>2,3,4</tri></modelSet>"
        profile = {
            "format": "foten-actuator",
            "version": 1,
            "name": "coil",
            "resonance_hz": 55.0,
            "gain": 8.0,
            "limit": 2.0,
        }
        files = [(".mat", f"{stem}73.mat")] + [
            (ending, f"{stem}{ending}") for ending in (".npy", ".mat", ".tdms", ".wav", ".xlsx")
        ]
        return [
            *((suffix, Path(file).read_bytes()) for suffix, file in files),
            (".xml", xml.encode()),
            (".json", json.dumps(profile).encode()),
        ]


_CELLS = [
    "", "nan", "inf", "-inf", "1e308", "1e400", "9" * 400, "9" * 5000, "1_000", "0x10", "x", '"', '"a\nb"', "\0", "\x1b[31m",
    "1e-320", "true", "=1+1", "١٢", "force [lbf", "force [kg]", "(", "[]", "time", "a" * 200_000, "#", "%", "1,5", " ",
]  # fmt: skip


def hostile_value(rng: random.Random) -> Any:
    """A JSON value that seldom belongs where it is put."""
    numbers = [-1, 0, 1, 3, 2**31, 2**63, 2**70, 10**400, 0.5, 1e308, -1e308, 5e-324, math.nan, math.inf]
    others = [
        None,
        True,
        "",
        "x",
        "\ud800",
        "x" * 10_000,
        "\x1b[31m\n",
        [],
        [None],
        {},
        {"a": None},
        [1, 2],
        ["a", [0]],
    ]
    return rng.choice([rng.choice(numbers), rng.choice(numbers), rng.choice(others)])


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Bytes with bits flipped, a piece overwritten, moved or cut out, or the end missing."""
    out = bytearray(data)
    # Headers are short and decide most.
    reach = len(out) if rng.random() < 0.5 else min(len(out), 3000)
    for _ in range(rng.choice([1, 1, 2, 8])):
        at, length = rng.randrange(reach), rng.choice([1, 4, 8, 64, 500])
        match rng.randrange(8):
            case 0 | 1 | 2:
                out[at % len(out)] ^= 1 << rng.randrange(8)
            case 3:
                out[at : at + length] = rng.randbytes(len(out[at : at + length]))
            case 4:
                out[at : at + length] = rng.choice([b"\0", b"\xff", b"\x7f"]) * len(out[at : at + length])
            case 5:
                source = rng.randrange(len(out))
                out[at : at + length] = out[source : source + length]
            case 6:
                del out[at : at + length]
            case _:
                del out[rng.randrange(1, len(out) + 1) :]
        out = out or bytearray(b"\0")
        reach = min(reach, len(out))
    return bytes(out)


def _deep(rng: random.Random) -> str:
    return rng.choice(["[" * DEEP, "[" * DEEP + "]" * DEEP, '{"a":' * DEEP + "1" + "}" * DEEP, "[" * 500 + "]" * 500])


def _set_somewhere(tree: Any, value: Any, rng: random.Random) -> None:
    """Put a value somewhere into nested dicts and lists, or take what stands there away."""
    while True:
        if isinstance(tree, dict) and tree:
            key: Any = rng.choice(list(tree))
        elif isinstance(tree, list) and tree:
            key = rng.randrange(len(tree))
        else:
            return
        if isinstance(tree[key], dict | list) and tree[key] and rng.random() < 0.8:
            tree = tree[key]
            continue
        if rng.random() < 0.1:
            del tree[key]
        else:
            tree[key] = value
        return


def _json_with_hostile_values(data: bytes, rng: random.Random) -> bytes:
    document = json.loads(data)
    _set_somewhere(document, hostile_value(rng), rng)
    return _deep(rng).encode() if rng.random() < 0.2 else json.dumps(document).encode()


def _attribute(rng: random.Random) -> Any:
    numbers = [np.nan, np.inf, -1.0, 0.0, 1e-300, 1e300, 1e13, 2**62, True]
    return rng.choice(
        [*numbers, "", "N", "x" * 5000, "\x1b[31m\n", np.zeros(0), np.ones(3), np.bytes_(b"\xff"), h5py.Empty("f8")]
    )


def _odd_dataset(file: h5py.File, name: str, rng: random.Random) -> None:
    """Put something at a name that looks like a dataset, or is one that no memory holds."""
    match rng.randrange(12):
        case 0:
            file.create_dataset(name, shape=(10**12,), dtype="f8", chunks=(1000,))
        case 1:
            file.create_dataset(name, shape=(10**6, 10**6), dtype="f4", chunks=(10, 10), compression="gzip")
        case 2:
            file.create_dataset(name, shape=(500,), dtype="f8", external=[("/etc/hostname", 0, 4000)])
        case 3:
            file[name] = h5py.ExternalLink("/etc/hostname", "/")
        case 4:
            file[name] = h5py.SoftLink(rng.choice([f"/{name}", "/nowhere", "/"]))
        case 5:
            layout = h5py.VirtualLayout(shape=(100,), dtype="f8")
            layout[:] = h5py.VirtualSource("/tmp/other.h5", "a", shape=(100,))
            file.create_virtual_dataset(name, layout)
        case 6:
            file[name] = np.array(rng.choice([np.nan, np.inf, 1e300]) * np.ones(N))
        case 7:
            kinds = ["i1", ">f8", "f2", "u8", "c16", "S5", "V7", "?", [("a", "f8"), ("b", "i4")], h5py.ref_dtype]
            file.create_dataset(name, shape=(rng.choice([0, 1, 7, N]),), dtype=np.dtype(rng.choice(kinds)))
        case 8:
            file.create_dataset(name, data=h5py.Empty("f8"))
        case 9:
            group = file.create_group(name)
            for _ in range(400):
                group = group.create_group("g")
            group["top"] = file["/"]
        case 10:
            file.create_dataset(name, data=rng.choice(["text", ["a", "b"]]))
        case _:
            file.create_dataset(name, data=np.zeros((2, 3, 4, 5)))


def _npy(rng: random.Random) -> bytes:
    """A .npy file whose header lies or is odd."""
    shapes = [
        "(1000000000000,)",
        "(-1,)",
        "(2, 99999999999999999999)",
        "(0,)",
        "()",
        "(3, 1000000)",
        "((((((1,))))))",
        "(True,)",
    ]
    kinds = [
        "'<f8'",
        "'|O'",
        "'<M8[ns]'",
        "'<f2'",
        "'>c16'",
        "'<U3'",
        "[('a', '<f8'), ('b', '|O')]",
        "'|V0'",
        "'x'",
        "'<f16'",
    ]
    fields = {
        "descr": rng.choice(kinds),
        "fortran_order": rng.choice(["False", "True", "3"]),
        "shape": rng.choice(shapes),
    }
    text = f"{{{', '.join(f'{name!r}: {value}' for name, value in fields.items())}, }}"
    text = rng.choice([text, text, text, "(" * 9000, "[" * DEEP, "{}", "", "9" * 5000])
    version = rng.choice([b"\x01\x00", b"\x01\x00", b"\x02\x00", b"\x09\x00"])
    size = struct.pack("<H", min(len(text), 65535)) if version == b"\x01\x00" else struct.pack("<I", len(text))
    return b"\x93NUMPY" + version + size + text.encode() + bytes(rng.choice([0, 8, 24, 8 * N]))


# Run by a child process: each case on a line of its own, what it printed beside it.
_CHILD = """
import importlib, json, os, signal, sys, traceback
from pathlib import Path

class Hung(BaseException):
    pass

def hung(*_):
    raise Hung

sys.path[:0] = sys.argv[7:]
_status = importlib.import_module(sys.argv[6])._status
signal.signal(signal.SIGALRM, hung)
cases, results = json.loads(Path(sys.argv[1]).read_text()), open(sys.argv[2], "a")
for k in range(int(sys.argv[3]), len(cases)):
    captured = os.open(sys.argv[4], os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    out = os.open(sys.argv[4] + ".out", os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 1); os.dup2(captured, 2)
    signal.setitimer(signal.ITIMER_REAL, float(sys.argv[5]))
    try:
        status = _status(cases[k])
    except Hung:
        status = None
    except SystemExit as error:
        status = error.code
    except BaseException:
        traceback.print_exc()
        status = 99
    signal.setitimer(signal.ITIMER_REAL, 0)
    sys.stdout.flush(); sys.stderr.flush()
    os.close(captured); os.close(out)
    texts = [Path(sys.argv[4] + end).read_text(errors="replace") for end in (".out", "")]
    print(json.dumps([k, status, *texts]), file=results, flush=True)
"""


def run_commands(
    cases: Sequence[Sequence[str]],
    longest_s: float = LONGEST_S,
    of: str = "foten.cli.command_line",
    path: Path | None = None,
) -> list[Result]:
    """What each command did: many in one process, and a new process after one that crashed or hung.

    Args:
        cases: the arguments of each.
        longest_s: of one of them.
        of: the module that has `_status`, which runs a command.
        path: where that is looked for first.
    """
    results: list[Result] = []
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    environment.pop("FOTEN_DEBUG", None)
    with tempfile.TemporaryDirectory() as folder:
        listed, answers, captured = (Path(folder) / name for name in ("cases", "answers", "captured"))
        listed.write_text(json.dumps([list(case) for case in cases]))
        while len(results) < len(cases):
            answers.write_text("")
            files = [str(listed), str(answers), str(len(results)), str(captured), str(longest_s), of]
            files += [str(path)] if path else []
            process = subprocess.Popen(
                [sys.executable, "-c", _CHILD, *files], env=environment, stdin=subprocess.DEVNULL
            )
            status: int | None
            try:
                # Python's own alarm ends what hangs in Python; what hangs in C is ended here.
                status = process.wait(timeout=longest_s * 2 + 2 * (len(cases) - len(results)))
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()
                status = None
            for line in answers.read_text().splitlines():
                k, code, out, err = json.loads(line)
                results.append(Result(tuple(cases[k]), code, out, err))
            if len(results) < len(cases):
                err = captured.read_text(errors="replace") if captured.exists() else ""
                results.append(Result(tuple(cases[len(results)]), status, "", err))
    return results


def run_hostile(generator: Generator, numbers: Sequence[int], folder: Path) -> list[Result]:
    """What the command line did with the hostile files of some numbers; the files are gone afterwards."""
    cases: list[list[str]] = []
    for number in numbers:
        cases += generator.write(number, folder)[1]
    return run_commands(cases)
