"""A step of the paper's network in every engine, side by side on one core: how long, and how near to what the core can do.

    python benchmarks/step.py [--texture T.foten] [--n 4000] [--csv FILE]

Each engine predicts the next sample from one window, called from Python one by one as an application would, the wasm from Node.
They take turns, a few hundred calls each, so that a machine that is slower for a while is so for all. Engines that are not
installed are said to be missing: `pip install ./packages/foten './packages/foten-lab[bench]'` has ONNX Runtime and OpenVINO.
The floor is the multiply-adds of the exactly pruned network over the peak of this core, measured beside them by
`benchmarks/peak.c` with the compiler that is here.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import numpy as np

from bench import ROOT, parser_of, report, times_us, untrained
from foten.models.texture_file import Texture, read_texture

INSTRUCTION_SETS = ("avx512", "avx2", "neon", "portable")
ROUND = 200  # calls in a turn
PERCENTILES = (50.0, 99.0, 99.9)

CHILD = """
import sys, json
import numpy as np
from bench import times_us
from foten.runtime.binding import isa
from foten.runtime.native import NativeState, NativeTexture
texture = NativeTexture(open(sys.argv[1], "rb").read())
state, out = NativeState(texture, excitation=False), np.empty(1, dtype=np.float32)
state.set_condition(*map(float, sys.argv[2:4]))
print(isa(), flush=True)
for line in sys.stdin:
    print(json.dumps(times_us(lambda: state.render(out), int(line))), flush=True)
"""
NODE = """
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { Foten } from %(module)s;
const foten = await Foten.load(readFileSync(%(wasm)s));
const renderer = foten.texture(readFileSync(process.argv[2])).renderer({ excitation: false });
renderer.setCondition(Number(process.argv[3]), Number(process.argv[4]));
const out = new Float32Array(1);
console.log(foten.isa);
for await (const line of createInterface({ input: process.stdin })) {
  const times = [];
  for (let i = 0; i < Number(line); i++) {
    const begin = process.hrtime.bigint();
    renderer.render(out);
    times.push(Number(process.hrtime.bigint() - begin) / 1000);
  }
  console.log(JSON.stringify(times));
}
"""


class Child:
    """An engine in a process of its own that times itself when it is asked to."""

    def __init__(self, command: list[str], env: dict[str, str] | None = None) -> None:
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={**os.environ, **(env or {})}
        )
        self.isa = self._line()

    def __call__(self, n: int) -> list[float]:
        """Times of n calls [µs]."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{n}\n")
        self._process.stdin.flush()
        return list(json.loads(self._line()))

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(10)

    def _line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline().strip()
        if not line:
            raise OSError("an engine ended without an answer")
        return line


def engines(texture: Texture, file: Path) -> dict[str, Any]:
    """What times each engine that is here, by name; None for one that is missing, which is told."""
    low, high = texture.trained_range("speed")
    condition = [f"{0.5 * (low + high):g}", f"{sum(texture.trained_range('force')) / 2:g}"]
    runners: dict[str, Any] = {}
    path = os.pathsep.join([str(ROOT / "benchmarks"), *filter(None, [os.environ.get("PYTHONPATH")])])
    for name in INSTRUCTION_SETS:
        child = Child([sys.executable, "-c", CHILD, str(file), *condition], {"FOTEN_ISA": name, "PYTHONPATH": path})
        if child.isa == name:
            runners[name] = child
        else:
            child.close()
    if shutil.which("node"):
        wasm = ROOT / "packages/foten/native" / "wasm"
        program = NODE % {
            "module": json.dumps((wasm / "foten.mjs").as_uri()),
            "wasm": json.dumps(str(wasm / "foten.wasm")),
        }
        script = file.with_suffix(".mjs")
        script.write_text(program)
        runners["wasm"] = Child(["node", str(script), str(file), *condition])
    runners |= frameworks(texture, file)
    return runners


def frameworks(texture: Texture, file: Path) -> dict[str, Any]:
    """What times PyTorch, eager and compiled, ONNX Runtime and OpenVINO on the same window."""
    import torch

    from foten.models.graph import graph_of
    from foten_lab.baselines.networks import build

    torch.set_num_threads(1)
    network = build(texture.sizes)
    network.load_state_dict({name: torch.from_numpy(texture.tensors[name].copy()) for name in network.state_dict()})
    network = network.float().eval()
    window = _plain(texture.tensors["golden.windows"])[None].astype(np.float32)
    tensor = torch.from_numpy(window)
    runners: dict[str, Any] = {}
    with torch.inference_mode():
        runners["eager"] = partial(times_us, lambda: network(tensor))
        try:
            compiled = torch.compile(network)
            compiled(tensor)
            runners["compiled"] = partial(times_us, lambda: compiled(tensor))
        except Exception as error:  # a compiler that is missing, and much else: the row is left out and says so
            print(f"compiled: left out, {type(error).__name__}", file=sys.stderr)
    onnx = file.with_suffix(".onnx")
    onnx.write_bytes(graph_of(network, texture.window).tobytes())
    try:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        session = onnxruntime.InferenceSession(str(onnx), options, providers=["CPUExecutionProvider"])
        inputs = {session.get_inputs()[0].name: window}
        _agrees("ONNX Runtime", session.run(None, inputs)[0], network, tensor)
        runners["onnxruntime"] = partial(times_us, lambda: session.run(None, inputs))
    except ImportError as error:
        print(f"onnxruntime: left out, {error}; pip install './packages/foten-lab[bench]'", file=sys.stderr)
    try:
        import openvino

        model = openvino.Core().compile_model(
            str(onnx),
            "CPU",
            {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_NUM_THREADS": 1, "INFERENCE_PRECISION_HINT": "f32"},
        )
        request = model.create_infer_request()
        _agrees("OpenVINO", request.infer([window])[0], network, tensor)
        runners["openvino"] = partial(times_us, lambda: request.infer([window]))
    except ImportError as error:
        print(f"openvino: left out, {error}; pip install './packages/foten-lab[bench]'", file=sys.stderr)
    return runners


def _plain(windows: np.ndarray) -> np.ndarray:
    """A window whose mean, and whose sum in turns, are positive.

    ONNX has no atan2, and what PyTorch writes for it gives (0, −1) the angle −π: for others it would not be the same network.
    """
    turns = (-1.0) ** np.arange(windows.shape[1])
    return next(w for w in windows if w[:, 0].sum() > 0 and w[:, 0] @ turns > 0)


def _agrees(engine: str, predicted: np.ndarray, network: Any, tensor: Any) -> None:
    import torch

    with torch.inference_mode():
        expected = network(tensor).numpy()
    error = float(np.abs(predicted.ravel() - expected.ravel()).max())
    if not error < 1e-3:
        sys.exit(f"{engine} predicts another sample, off by {error:.3g}: it runs another network")


def peaks(folder: Path) -> dict[str, float]:
    """The multiply-adds a second of this core by instruction set; none without a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        print("floor: left out, no C compiler", file=sys.stderr)
        return {}
    program = folder / "peak"
    subprocess.run(
        [compiler, "-O2", "-ffp-contract=fast", str(ROOT / "benchmarks" / "peak.c"), "-o", str(program)], check=True
    )
    done = subprocess.run([str(program)], check=True, capture_output=True, text=True)
    return {name: float(rate) for name, rate in (line.split() for line in done.stdout.splitlines())}


def measured(texture: Texture, n: int) -> tuple[dict[str, list[float]], float | None]:
    """Times of each engine [µs], and the multiply-adds a second of this core; None without a compiler."""
    import torch

    with tempfile.TemporaryDirectory() as folder, torch.inference_mode():
        file = Path(folder) / "t.foten"
        file.write_bytes(texture.to_bytes())
        rates = [*peaks(Path(folder)).values()]
        runners = engines(texture, file)
        times: dict[str, list[float]] = {name: [] for name in runners}
        for run in runners.values():
            run(ROUND)  # warm
        while min(map(len, times.values())) < n:
            for name, run in runners.items():
                times[name] += run(ROUND)
        rates += peaks(Path(folder)).values()
        for run in runners.values():
            if isinstance(run, Child):
                run.close()
    return times, max(rates, default=None)  # the faster of before and after: what the core can do


def table(times: dict[str, list[float]], multiply_adds: int, peak: float | None) -> list[list[str]]:
    """The engines, the fastest first, beside the best native one, and the floor."""
    us = {name: np.percentile(values, PERCENTILES).tolist() for name, values in times.items()}
    best = min((name for name in INSTRUCTION_SETS if name in us), key=lambda name: us[name][0])
    rows = {name: (name, *(f"{value:.1f}" for value in of), f"{of[0] / us[best][0]:.2f}") for name, of in us.items()}
    order = {name: of[0] for name, of in us.items()}
    if peak is not None:
        order["floor"] = floor = 1e6 * multiply_adds / peak
        of_floor = f"floor, {multiply_adds:,} multiply-adds"
        rows["floor"] = (of_floor, f"{floor:.1f}", "", "", f"{floor / us[best][0]:.2f}")
    heads = ["engine", "p50 [µs]", "p99", "p99.9", f"÷ {best}"]
    return [heads, *(list(rows[name]) for name in sorted(order, key=order.__getitem__))]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument(
        "--texture", type=Path, metavar="T.foten", help="of the paper's network; an untrained one by default"
    )
    parser.add_argument("--n", type=int, default=4000, help="calls of each engine")
    arguments = parser.parse_args()
    texture = read_texture(arguments.texture) if arguments.texture else untrained("foten")
    times, peak = measured(texture, arguments.n)
    report(table(times, texture.sizes.multiply_adds(), peak), arguments.csv)


if __name__ == "__main__":
    main()
