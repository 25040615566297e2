"""The families of models, free of any framework, one file each: sizes, tensor shapes, cost, limits."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from foten.baselines import sizes as graphs
from foten.models.foten.sizes import FotenSizes
from foten.models.foten.ten_sizes import TenSizes
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.model_sizes import Sizes, shortened
from foten.models.piecewise_ar.sizes import PiecewiseArSizes

FAMILIES: dict[str, type[Sizes]] = {
    "foten-plus": FotenPlusSizes,
    "foten": FotenSizes,
    "ten": TenSizes,
    "ar": PiecewiseArSizes,
    "ten-mfcc": graphs.TenMfccSizes,
    "ten-wavelet": graphs.TenWaveletSizes,
    "foten-d": graphs.FotenDSizes,
    "fnn": graphs.FnnSizes,
    "dstn": graphs.DstnSizes,
    "hapinf": graphs.HapinfSizes,
    "ldhtd": graphs.LdhtdSizes,
    "dftnet": graphs.DftnetSizes,
    "gan": graphs.GanSizes,
}
"""By the key that names a model on the command line and in a card."""


def sizes_of(model: str, card: Mapping[str, Any]) -> Sizes:
    """Return the sizes that a card gives for a model.

    Raises:
        ValueError: the model or a size is unknown, or a size is out of range.
    """
    if model not in FAMILIES:
        raise ValueError(f"unknown model {shortened(model)}, expected one of {', '.join(FAMILIES)}")
    known = [field.name for field in fields(FAMILIES[model])]
    unknown = set(card) - set(known)
    if unknown:
        raise ValueError(f"{model} has no size {min(unknown)!r}, expected one of {', '.join(known)}")
    return FAMILIES[model](**card)
