"""NumPy, MATLAB and foreign HDF5 files; never a pickle."""

import zipfile

import h5py
import numpy as np
import pytest
import scipy.io

from foten.datasets.binary import read_hdf5, read_numpy
from foten.datasets.hdf5 import write_recording
from foten.datasets.isolated import isolated_columns
from foten.recording.recording import Channel, Recording

FORCE = np.linspace(0, 3, 40)
AXES = np.random.default_rng(0).standard_normal((200, 3))


def _by_name(columns):
    return {column.name: column.samples for column in columns}


def test_pickles_are_not_opened(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (pytest.fail, ("a pickle was opened",))

    bomb = np.array([Bomb()], dtype=object)
    np.savez(tmp_path / "a.npz", force=bomb)
    np.save(tmp_path / "a.npy", bomb)
    for name in ("a.npz", "a.npy"):
        with pytest.raises(ValueError, match=f"{name} holds pickled objects, which can run code"):
            read_numpy(tmp_path / name)


def test_arrays_without_a_meaning_carry_a_fault(tmp_path):
    np.savez(tmp_path / "a.npz", name=np.array(["denim"]), z=np.ones(5) * 1j, cube=np.zeros((2, 3, 4)))
    assert [bool(column.fault) for column in read_numpy(tmp_path / "a.npz")] == [True, True, True]
    np.savez(tmp_path / "b.npz", force=FORCE)
    assert [(column.fault, column.n_blank) for column in read_numpy(tmp_path / "b.npz")] == [("", 0)]


def test_matlab_v5_with_a_struct(tmp_path):
    variables = {"trial": {"acc": AXES, "force": FORCE[:, None], "note": "two strokes"}, "fs": 10_000.0}
    scipy.io.savemat(tmp_path / "a.mat", variables)
    columns = isolated_columns("MATLAB", tmp_path / "a.mat")
    by_name = _by_name(columns)
    np.testing.assert_array_equal(by_name["trial.acc.1"], AXES[:, 1])
    np.testing.assert_array_equal(by_name["trial.force"], FORCE)
    assert by_name["fs"].tolist() == [10_000]
    assert next(column for column in columns if column.name == "trial.note").fault


def test_matlab_v73(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, array in {"acc": AXES, "force": FORCE[:, None]}.items():
            dataset = file.create_dataset(name, data=array.T)  # MATLAB stores columns first
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
    with (tmp_path / "a.mat").open("r+b") as raw:  # the block before the HDF5 part says what it is
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    by_name = _by_name(isolated_columns("MATLAB", tmp_path / "a.mat"))
    assert list(by_name) == ["acc.0", "acc.1", "acc.2", "force"]  # in every run: a column may go by its number
    np.testing.assert_array_equal(by_name["acc.2"], AXES[:, 2])
    np.testing.assert_array_equal(by_name["force"], FORCE)


def test_foreign_hdf5_by_the_paths_of_its_datasets(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["trial/ft"], file["trial/time_ft"], file["label"] = AXES, np.arange(200) / 100, "denim"
    columns = read_hdf5(tmp_path / "a.h5")
    np.testing.assert_array_equal(_by_name(columns)["trial/ft.2"], AXES[:, 2])
    assert {c.name for c in columns if c.fault} == {"label"}


def test_our_own_recording_needs_no_import(tmp_path):
    write_recording(Recording({"force": Channel(FORCE, 100.0)}), tmp_path / "a.h5")
    with pytest.raises(ValueError, match="is a foten recording already"):
        read_hdf5(tmp_path / "a.h5")


def _lying(shape, n_bytes=800, descr="<f8"):
    """A .npy file whose header states a shape, with so many bytes after it."""
    header = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(n_bytes)


@pytest.mark.parametrize("shape", [(10**12,), (10**6, 10**6), (-100,), (99,), (10**30, 0)])
def test_a_size_that_the_file_does_not_have_is_refused(tmp_path, shape):
    (tmp_path / "a.npy").write_bytes(_lying(shape))
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("force.npy", _lying(shape))
    for name in ("a.npy", "a.npz"):
        with pytest.raises(ValueError, match=f"{name} is truncated or is no NumPy file"):
            read_numpy(tmp_path / name)


def test_headers_that_numpy_fails_on_are_refused(tmp_path):
    for k, header in enumerate([b"(" * 9000, b"[" * 9000, b"", b"9" * 5000]):
        data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
        (tmp_path / f"{k}.npy").write_bytes(data)
        with pytest.raises(ValueError, match=f"{k}.npy is truncated or is no NumPy file") as refusal:
            read_numpy(tmp_path / f"{k}.npy")
        assert len(str(refusal.value)) < 300


@pytest.mark.parametrize("order", ["C", "F"])
def test_the_longer_axis_is_time_whichever_way_round_and_in_any_type(tmp_path, order):
    axes = np.asarray(AXES, order=order)
    np.save(tmp_path / "a.npy", FORCE)
    np.save(tmp_path / "b.npy", axes.T)
    np.savez_compressed(tmp_path / "c.npz", force=FORCE.astype(np.float32), acc=axes, fs=10_000, big=axes.astype(">f4"))
    assert list(_by_name(read_numpy(tmp_path / "a.npy"))) == ["0"]
    np.testing.assert_array_equal(_by_name(read_numpy(tmp_path / "b.npy"))["1"], AXES[:, 1])
    by_name = _by_name(read_numpy(tmp_path / "c.npz"))
    assert list(by_name) == ["force", "acc.0", "acc.1", "acc.2", "fs", "big.0", "big.1", "big.2"]
    np.testing.assert_array_equal(by_name["acc.2"], AXES[:, 2])
    np.testing.assert_array_equal(by_name["force"], FORCE.astype(np.float32))
    np.testing.assert_array_equal(by_name["big.1"], AXES[:, 1].astype(np.float32))
    assert by_name["fs"].tolist() == [10_000]


def test_names_are_printable(tmp_path):
    np.savez(tmp_path / "a.npz", **{"acc\n\x1b[31m": FORCE})
    assert list(_by_name(read_numpy(tmp_path / "a.npz"))) == ["acc??[31m"]
