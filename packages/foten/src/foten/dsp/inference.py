"""Inference on means: standard error, Student's quantile, and Holm's correction for many comparisons."""

import numpy as np

from foten.dsp import Array


def standard_error(values: Array) -> float | None:
    """Standard error of the mean of values (n,); None of a single one."""
    return float(values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else None


def student_quantile(n: int) -> float:
    """Reach of the 95 % interval of a mean of n values, in standard errors; NaN for one value."""
    from scipy.special import stdtrit

    return float(stdtrit(n - 1, 0.975)) if n > 1 else float("nan")


def holm(p: Array) -> Array:
    """P values adjusted along the last axis; Holm, Scandinavian Journal of Statistics 6, 65 (1979)."""
    m = p.shape[-1]
    order = np.argsort(p, axis=-1, kind="stable")
    stepped = np.maximum.accumulate(np.take_along_axis(p, order, -1) * np.arange(m, 0, -1), axis=-1)
    adjusted = np.empty_like(p)
    np.put_along_axis(adjusted, order, np.minimum(stepped, 1.0), -1)
    return adjusted
