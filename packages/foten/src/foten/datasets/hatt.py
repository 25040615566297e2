"""Model files of the Penn Haptic Texture Toolkit: linear models of one surface, each at a speed and a force, as XML.

Source: the public files (Culbertson, Lopez Delgado and Kuchenbecker, Haptics Symposium 2014): AR at 10 kHz, or ARMA with a
gain at 1 kHz; m/s², mm/s, N. Their notice allows non-profit research and no distribution.
"""

import xml.etree.ElementTree as Xml
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.untrusted import read_whole

MAX_FILE_BYTES = 2_000_000  # the toolkit's have 100,000
MAX_MODELS, MAX_NUMBER = 1000, 1e12  # of a file, and of any figure in it
UNITS = {"AccelUnits": "m/s^2", "SpeedUnits": "mm/s", "ForceUnits": "N"}


@dataclass(frozen=True)
class HattModels:
    """Models of a file; y[n] = −Σ a_k y[n−k] + gain · (e[n] + Σ b_k e[n−k]), e white, Gaussian."""

    material: str
    rate_hz: float  # of the models
    friction: float  # coefficient μ of the surface; NaN where the file has none
    points: Array  # speed [mm/s] and force [N] of each model, shape (n, 2)
    ar: Array  # a, 1 first, shape (n, p + 1)
    ma: Array  # b, 1 first, shape (n, q + 1); q is 0 where there are no zeros
    variance: Array  # of e [m²/s⁴], shape (n,)
    gain: Array  # shape (n,); 1 where the file has none
    triangles: NDArray[np.int64]  # three models each, from 0, shape (t, 3)


def read_models(path: Path) -> HattModels:
    """Models in a file; ValueError where it is not a model file, or its parts do not fit together."""
    data = read_whole(path, MAX_FILE_BYTES)
    try:
        return _models(Xml.fromstring(data))
    except Xml.ParseError as error:
        raise ValueError(f"{path.name}: this is not XML, or it is truncated ({error})") from error
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def _models(root: Xml.Element) -> HattModels:
    if root.tag == "tapSet":
        raise ValueError("these are taps, expected the textures of a <modelSet>; taps are not rendered")
    if root.tag != "modelSet":
        raise ValueError(f"the root is <{root.tag}>, expected <modelSet>: is it a model file of Penn's toolkit?")
    for name, unit in UNITS.items():
        of_file = root.findtext(name, unit).strip()
        if of_file.replace("²", "^2") not in (unit, unit.replace("^", "")):
            raise ValueError(f"<{name}> is {of_file!r}, expected {unit!r}")
    models = root.findall("model")
    if not 3 <= len(models) <= MAX_MODELS:
        raise ValueError(f"the file holds {len(models)} models, expected 3 to {MAX_MODELS}: is it truncated?")
    stated = root.findtext("numMod")
    if stated is not None and int(_number(stated, "numMod")) != len(models):
        raise ValueError(f"<numMod> says {stated.strip()} models and the file holds {len(models)}: is it truncated?")

    def of_models(name: str, default: str | None = None) -> Array:
        return np.array([_number(model.findtext(name, default), name) for model in models])

    no_zeros = Xml.fromstring("<MAcoeff>1</MAcoeff>")
    friction = root.findtext("mu")
    read = HattModels(
        material=(root.findtext("material") or "").strip(),
        rate_hz=_number(root.findtext("SampleRate"), "SampleRate"),
        friction=np.nan if friction is None else _number(friction, "mu"),
        points=np.stack([of_models("speedMod"), of_models("forceMod")], axis=1),
        ar=_rows([model.find("ARcoeff") for model in models], "ARcoeff"),
        ma=_rows([next(model.iterfind("MAcoeff"), no_zeros) for model in models], "MAcoeff"),
        variance=of_models("var"),
        gain=of_models("gain", "1"),
        triangles=_triangles(root, len(models)),
    )
    if not 0 < read.rate_hz <= 1e6:
        raise ValueError(f"<SampleRate> is {read.rate_hz:g} Hz, expected a positive number of up to 1e6")
    for name, coefficients in (("ARcoeff", read.ar), ("MAcoeff", read.ma)):
        if not np.abs(coefficients[:, 0] - 1).max() < 1e-6:
            raise ValueError(f"<{name}> begins with {coefficients[0, 0]:g}, expected 1")
    for name, values in (("speedMod or forceMod", read.points), ("var", read.variance), ("gain", read.gain)):
        if not (values >= 0).all():
            raise ValueError(f"<{name}> is negative in a model, expected 0 or more")
    return read


def _triangles(root: Xml.Element, n: int) -> NDArray[np.int64]:
    corners = root.findall("tri")
    if not 0 < len(corners) <= 2 * n:  # of a mesh without overlaps
        raise ValueError(f"the file has {len(corners)} <tri>, expected 1 to {2 * n} between the models")
    triangles = _rows(corners, "tri")
    if triangles.shape[1] != 3 or not (triangles == np.round(triangles)).all():
        raise ValueError("a <tri> is not three integers")
    if triangles.min() < 1 or triangles.max() > n:
        raise ValueError(f"a <tri> names models {triangles.min():g} to {triangles.max():g}, expected 1 to {n}")
    return triangles.astype(np.int64) - 1


def _rows(elements: Sequence[Xml.Element | None], name: str) -> Array:
    """Lists of numbers as rows, each in <value>s or with commas or blanks between them."""
    rows = []
    for element in elements:
        if element is None:
            raise ValueError(f"a model has no <{name}>")
        values = [value.text or "" for value in element.iter("value")]
        rows.append([_number(word, name) for word in values or (element.text or "").replace(",", " ").split()])
    lengths = sorted({len(row) for row in rows})
    if len(lengths) > 1 or lengths[0] == 0:
        raise ValueError(f"<{name}> has {lengths[0]} to {lengths[-1]} numbers, expected as many in every one")
    return np.array(rows)


def _number(text: str | None, name: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        raise ValueError(f"<{name}> is {(text or '').strip()[:30]!r}, expected a number") from None
    if not abs(value) <= MAX_NUMBER:
        raise ValueError(f"<{name}> is {value}, expected a number of up to {MAX_NUMBER:g}")
    return value
