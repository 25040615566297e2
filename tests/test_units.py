"""Units: as large as physics has them, and read wherever a file states them; converted or refused, never dropped."""

import inspect

import h5py
import numpy as np
import openpyxl
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from foten.cli.recordings import import_
from foten.datasets.importing import import_recording
from foten.datasets.options import ImportOptions
from foten.datasets.units import FACTORS, canonical, factor_of, split_header

SAMPLES = np.linspace(0.5, 1.5, 300)
LBF_N = 4.4482216152605  # exact: 0.45359237 kg × 9.80665 m/s²


def test_the_help_names_units_that_are_read():
    message = inspect.signature(import_).parameters["units"].default.help
    named = dict(p.strip().split(" ", 1) for p in message.split("of the file:")[1].split(". CHANNEL")[0].split(";"))
    assert set(named) == set(FACTORS)
    for quantity, units in named.items():
        assert {unit.strip() for unit in units.split(",")} <= set(FACTORS[quantity])


def test_units_have_the_size_that_physics_gives():
    # 1 g is 9.80665 m/s², 1 gf is the weight of 1 g of mass: 9.80665 mN.
    assert FACTORS["acceleration"]["g"] == 9.80665
    assert FACTORS["acceleration"]["Gal"] == FACTORS["acceleration"]["cm/s^2"] == 0.01
    assert FACTORS["acceleration"]["ft/s^2"] == pytest.approx(0.3048)
    assert FACTORS["force"]["gf"] == pytest.approx(9.80665e-3)
    assert FACTORS["force"]["lbf"] == pytest.approx(LBF_N, rel=1e-15)
    assert FACTORS["force"]["ozf"] == pytest.approx(LBF_N / 16, rel=1e-15)
    assert FACTORS["speed"]["m/s"] == FACTORS["position"]["m"] == 1000
    assert FACTORS["speed"]["in/s"] == FACTORS["position"]["in"] == 25.4
    assert FACTORS["speed"]["km/h"] == pytest.approx(1e6 / 3600)


@pytest.mark.parametrize(
    ("unit", "spellings"),
    {
        "m/s^2": "m/s²|m/s2|m/s**2|m s-2|m s⁻²|m·s^-2|ms-2|m/s/s|m_s2|m_per_s2|metres/second^2|m/(s^2)|mps2|M/S^2",
        "mm/s": "mm/sec|mm s-1|mm_s|millimetres per second|MM/S",
        "in/s": "inch/s|ips|inches per second",
        "um": "µm|μm|microns",
        "g": "G|Gs|gee",
        "mg": "mG|milli-g",
        "Gal": "gal",
        "lbf": "LBF|pounds-force|lb-f",
        "lb": "lbs|Pounds",
        "kN": "KN|kilonewtons",
        "mN": "mn|millinewton",
        "MN": "MN",  # mega, which no table has
        "V": "Volts|v",
        "ms": "msec|milliseconds|MS",
    }.items(),
)
def test_a_unit_has_many_spellings(unit, spellings):
    assert {canonical(spelling) for spelling in spellings.split("|")} == {unit}


@pytest.mark.parametrize(
    ("header", "kind", "split"),
    [
        ("Force [lbf]", "force", ("Force", "lbf")),
        ("force (furlong)", "force", ("force", "furlong")),
        ("force [V", "force", ("force", "V")),  # cut off
        ("force_lbf", "force", ("force", "lbf")),
        ("force_kg", "force", ("force", "kg")),
        ("F / N", "force", ("F", "N")),
        ("F in kN", "force", ("F", "kN")),
        ("speed_m_s", "speed", ("speed", "m_s")),
        ("v/(mm/s)", "speed", ("v", "mm/s")),
        ("Speed mm/s", "speed", ("Speed", "mm/s")),
        ("Acc [g] x", "acceleration", ("Acc x", "g")),
        ("acc_x_g", "acceleration", ("acc_x", "g")),
        ("acc_g_x", "acceleration", ("acc_x", "g")),
        ("acc_g.2", "acceleration", ("acc.2", "g")),  # a column of a matrix
        ("acc_counts", "acceleration", ("acc", "counts")),
        ("Force [lbf] (sensor 2)", "force", ("Force", "lbf")),
        # No units:
        ("force_n", "force", ("force_n", "")),  # normal
        ("force_v", "force", ("force_v", "")),  # vertical
        ("trial/time_ft", "time", ("trial/time_ft", "")),  # force and torque
        ("speed_in", "speed", ("speed_in", "")),  # input
        ("Force (normal)", "force", ("Force", "")),
        ("Voltage (Formula Result)", "force", ("Voltage", "")),
        ("force []", "force", ("force", "")),
        ("ax", "acceleration", ("ax", "")),
    ],
)
def test_headers_part_from_their_units(header, kind, split):
    assert split_header(header, kind) == split


@pytest.mark.parametrize(
    ("channel", "header", "factor"),
    [
        ("force", "force [lbf]", LBF_N),
        ("acceleration", "acceleration [milli-g]", 9.80665e-3),
        ("acceleration", "acc [cm/s²]", 0.01),
        ("speed", "speed (in/s)", 25.4),
        ("position_x", "x [µm]", 1e-3),
        ("time", "t [ms]", 1e-3),
    ],
)
def test_a_unit_in_a_header_is_converted_and_said(channel, header, factor):
    got, message = factor_of(channel, header)
    assert got == pytest.approx(factor, rel=1e-14)
    assert "was converted from" in message


@pytest.mark.parametrize(
    ("channel", "header", "message"),
    [
        ("force", "force [kg]", "'kg' of column 'force .kg.' is not one of N, .*a mass.*--unit force=kgf"),
        ("force", "force [lbs]", "--unit force=lbf"),
        ("force", "Force (g)", "--unit force=gf"),
        ("force", "force [V]", r"say how many N one V is, e.g. --unit force=V\*4.9; if it is no unit, --unit force=N"),
        ("acceleration", "acceleration [V]", r"--unit acceleration=V\*4.9"),
        ("acceleration", "acceleration [counts]", r"--unit acceleration=count\*4.9"),
        ("acceleration", "acc_counts", r"--unit acceleration=count\*4.9"),
        ("force", "force [furlong]", "'furlong' of column .* is not one of N"),
        ("force", "force [MN]", "'MN' of column"),
        ("force", "force [mm]", "is not one of N"),
        ("acceleration", "acceleration [-]", "is not one of m/s"),
        ("force", "force [%]", "say how many N one % is"),
        ("time", "t [samples]", "leave time out and give --rate"),
    ],
)
def test_a_unit_that_is_not_one_is_refused_with_what_may_be_meant(channel, header, message):
    with pytest.raises(ValueError, match=message) as refusal:
        factor_of(channel, header)
    assert "\n" not in str(refusal.value)


def test_what_the_user_says_goes_before_the_file_and_is_kept():
    assert factor_of("force", "force [lbf]", by_user="N") == (1.0, "force was taken as N, where its file states lbf")
    assert factor_of("force", "force [V]", by_user="V*4.9")[0] == 4.9
    assert factor_of("force", "force", by_user="*-2") == (-2.0, "force was multiplied by -2 to get N")
    with pytest.raises(ValueError, match="is in lbf by its name and in N by its unit"):
        factor_of("force", "force [lbf]", "N")


def _files(tmp_path, unit):
    """Write force in a unit, stated in each way that a format has; return the files with the column's name."""
    rows = [f"{k / 1000},{value}" for k, value in enumerate(SAMPLES)]
    heads = {
        f"force [{unit}]": [f"t,force [{unit}]"],
        f"force_{unit}": [f"t,force_{unit}"],
        "force": ["t,force", f"s,{unit}"],
        "fz": ["t,fz", f"[s],[{unit}]"],
    }
    for k, (column, head) in enumerate(heads.items()):
        (tmp_path / f"{k}.csv").write_text("\n".join(head + rows))
        yield tmp_path / f"{k}.csv", column
    book = openpyxl.Workbook()
    for row in (["t", "force"], ["s", unit], *([k / 1000, float(value)] for k, value in enumerate(SAMPLES))):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    yield tmp_path / "a.xlsx", "force"
    for name, texts in {"beside": {"force_unit": unit}, "alone": {"units": unit}}.items():
        np.savez(tmp_path / f"{name}.npz", force=SAMPLES, **texts)
        yield tmp_path / f"{name}.npz", "force"
    savemat(tmp_path / "a.mat", {"force": SAMPLES, "units": {"force": unit}})
    yield tmp_path / "a.mat", "force"
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["force"] = SAMPLES
        file["force"].attrs["Units"] = unit
    yield tmp_path / "a.h5", "force"
    for key in ("unit_string", "NI_UnitDescription"):
        with TdmsWriter(tmp_path / f"{key}.tdms") as writer:
            writer.write_segment([ChannelObject("rig", "force", SAMPLES, properties={key: unit})])
        yield tmp_path / f"{key}.tdms", "force"


def test_every_format_states_units_and_every_one_counts(tmp_path):
    for path, column in _files(tmp_path, "lbf"):
        options = ImportOptions((("force", column),), rate_hz=1000.0)
        samples = import_recording([path], options)[0]["force"].samples
        np.testing.assert_allclose(samples, SAMPLES * LBF_N, err_msg=path.name)
    for path, column in _files(tmp_path, "V"):
        with pytest.raises(ValueError, match=r"unit 'V' of column .* is not one of N"):
            import_recording([path], ImportOptions((("force", column),), rate_hz=1000.0))


def test_a_matrix_has_a_unit_for_each_column(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["ft"] = np.stack([SAMPLES, SAMPLES], axis=1)
        file["ft"].attrs["units"] = ["lbf", "furlong"]
    options = ImportOptions((("force", "ft.0"),), rate_hz=1000.0)
    np.testing.assert_allclose(import_recording([tmp_path / "a.h5"], options)[0]["force"].samples, SAMPLES * LBF_N)
    with pytest.raises(ValueError, match="furlong"):
        import_recording([tmp_path / "a.h5"], ImportOptions((("force", "ft.1"),), rate_hz=1000.0))
