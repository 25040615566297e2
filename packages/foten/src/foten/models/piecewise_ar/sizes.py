"""Piecewise AR [12]: local linear models scattered over speed and force, mixed between the three around a condition."""

from dataclasses import dataclass
from typing import ClassVar

from foten.models.model_sizes import ModelSizes, Shapes, check_count

MAX_AR_ORDER = 40  # beyond it line spectral frequencies no longer give the filter in float64


@dataclass(frozen=True)
class PiecewiseArSizes(ModelSizes):
    """The sizes of local models. Where `ma` is 0 each is an autoregression; Penn's texture toolkit has zeros as well."""

    window: int = 21  # samples that a prediction is given, p + 1 or more; more to infer the innovations before zeros
    order: int = 20  # p, of all models alike
    ma: int = 0  # q, of what the innovations go through before
    n_models: int = 3
    n_triangles: int = 1
    bounded: ClassVar[bool] = True
    excited: ClassVar[bool] = True  # by white noise of each model's variance

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("order", "ma"):
            check_count(name, getattr(self, name), 0, MAX_AR_ORDER)
        check_count("window", self.window, self.order + 1)

    def tensor_shapes(self) -> Shapes:
        n = self.n_models
        shapes: Shapes = {"points": (n, 2), "lsf": (n, self.order), "variance": (n,)}
        if self.ma:
            shapes |= {"ma_lsf": (n, self.ma), "gain": (n,)}
        shapes |= {"triangles": (self.n_triangles, 3), "scale": (2,), "mean": (2,), "sd": (2,)}
        return {f"piecewise_ar.{name}": shape for name, shape in shapes.items()}

    def multiply_adds(self) -> int:
        """The cost of mixing, multiplying out, stepping down to reflection coefficients, and running."""
        p, q = self.order, self.ma
        return 3 * (p + q + 2) + 2 * p * p + q * q + 10 * p + q
