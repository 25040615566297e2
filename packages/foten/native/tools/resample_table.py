"""Write `native/src/resample_table.h`: a low-pass that a change of rate needs, with as little delay as it can have.

    python packages/foten/native/tools/resample_table.py

Linear phase would delay by half of its length, 18 samples; the same magnitude with minimum phase delays slow vibration by 1.5.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.signal import firwin, kaiser_beta

STEPS = 128  # of the table in a sample
PASS, STOP = 0.45, 0.55  # of the slower rate
STOPPED_DB = 60.0  # of linear phase; the least delay leaves 58


def minimum_phase(magnitude: np.ndarray) -> np.ndarray:
    """Impulse response of least delay whose spectrum has a magnitude: by the cepstrum, shapes (n,) → (n,)."""
    n = magnitude.size
    cepstrum = np.fft.ifft(np.log(magnitude)).real
    folded = np.zeros(n)
    folded[0], folded[1 : n // 2], folded[n // 2] = 1.0, 2.0, 1.0
    return np.fft.ifft(np.exp(np.fft.fft(cepstrum * folded))).real


def kernel() -> np.ndarray:
    """Kernel h at multiples of 1/128 of a sample, the sum over samples 1 at each of them."""
    width = 2 * (STOP - PASS) / STEPS
    n = int(np.ceil((STOPPED_DB - 7.95) / (2.285 * np.pi * width))) | 1
    h = firwin(n, (PASS + STOP) / STEPS, window=("kaiser", kaiser_beta(STOPPED_DB)))
    spectrum = np.abs(np.fft.fft(h, 1 << int(np.ceil(np.log2(16 * n)))))
    response = minimum_phase(np.maximum(spectrum, 10 ** (-(STOPPED_DB + 10) / 20)))
    response[0] = 2 * response[1] - response[2]  # the floor of the spectrum stands there as an impulse
    length = -(-n // STEPS) * STEPS
    taps = response[:length].reshape(-1, STEPS)
    return (taps / taps.sum(axis=0)).ravel()


def main() -> None:
    table = kernel()
    lines = [
        "/* Made by native/tools/resample_table.py. */",
        "// clang-format off",
        f"enum {{ TABLE_STEPS = {STEPS}, TABLE_TAPS = {table.size // STEPS} }};",
        "static const float TABLE[TABLE_STEPS * TABLE_TAPS + 1] = {",
    ]
    values = [f"{value!s}f" for value in [*np.float32(table), 0.0]]  # the shortest text of each float32
    lines += ["    " + ", ".join(values[i : i + 6]) + "," for i in range(0, len(values), 6)]
    path = Path(__file__).parents[1] / "src" / "resample_table.h"
    path.write_text("\n".join([*lines, "};", ""]))


if __name__ == "__main__":
    main()
