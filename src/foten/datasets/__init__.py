"""Readers of file formats, and the simulator."""

from collections.abc import Callable
from pathlib import Path

from foten.datasets.arrays import read_hdf5, read_matlab, read_numpy
from foten.datasets.columns import Column
from foten.datasets.table import read_delimited, read_excel
from foten.datasets.tdms import read_tdms
from foten.datasets.wav import read_wav

DATASETS: dict[str, Callable[[Path], list[Column]]] = {
    ".csv": read_delimited,
    ".tsv": read_delimited,
    ".txt": read_delimited,
    ".dat": read_delimited,
    ".xlsx": read_excel,
    ".npz": read_numpy,
    ".npy": read_numpy,
    ".mat": read_matlab,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".tdms": read_tdms,
    ".wav": read_wav,
}
"""What reads a file, by its extension."""
