"""The families of models, free of any framework, one file each: sizes, tensor shapes, cost, limits."""

from collections.abc import Mapping
from typing import Any

from foten.families.foten import FotenSizes
from foten.families.foten_plus import FotenPlusSizes
from foten.families.graphs import (
    DftnetSizes,
    DstnSizes,
    FnnSizes,
    FotenDSizes,
    GanSizes,
    HapinfSizes,
    LdhtdHopSizes,
    LdhtdSizes,
    TenMfccSizes,
    TenWaveletSizes,
)
from foten.families.piecewise_ar import PiecewiseArSizes
from foten.families.sizes import Sizes, shortened, sizes_from_card
from foten.families.ten import TenSizes

FAMILIES: dict[str, type[Sizes]] = {
    "foten-plus": FotenPlusSizes,
    "foten": FotenSizes,
    "ten": TenSizes,
    "ar": PiecewiseArSizes,
    "ten-mfcc": TenMfccSizes,
    "ten-wavelet": TenWaveletSizes,
    "foten-d": FotenDSizes,
    "fnn": FnnSizes,
    "dstn": DstnSizes,
    "hapinf": HapinfSizes,
    "ldhtd": LdhtdSizes,
    "ldhtd-hop": LdhtdHopSizes,
    "dftnet": DftnetSizes,
    "gan": GanSizes,
}
"""By the key that names a model on the command line and in a card."""


def sizes_of(model: str, card: Mapping[str, Any]) -> Sizes:
    """Return the sizes that a card gives for a model.

    Raises:
        ValueError: the model or a size is unknown, or a size is out of range.
    """
    if model not in FAMILIES:
        raise ValueError(f"unknown model {shortened(model)}, expected one of {', '.join(FAMILIES)}")
    return sizes_from_card(FAMILIES[model], model, card)
