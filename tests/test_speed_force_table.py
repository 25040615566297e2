from __future__ import annotations

import numpy as np
import pytest

from foten.dsp.speed_force_table import spanning


@pytest.mark.parametrize("speed", [123.4, 50.0, 0.0])
@pytest.mark.parametrize("force", [0.77, 0.8, 0.0])
def test_a_hand_that_hardly_varied_has_one_vertex(speed: float, force: float) -> None:
    """What a low-pass leaves of a constant differs in its last bits, and by a little more where the hand trembled."""
    trembling = 1 + 0.005 * np.sin(np.arange(1000.0))
    for jitter in (1 + 1e-15 * np.sin(np.arange(1000.0)), trembling):
        plane = spanning(speed * jitter, force * jitter, 12, 3)
        assert len(plane.speed_knots) == len(plane.force_knots) == 1


def test_vertices_span_where_the_hand_was() -> None:
    plane = spanning(np.linspace(10, 200, 1000), np.linspace(0.5, 2.0, 1000), 12, 3)
    assert plane.speed_knots[[0, -1]].tolist() == [10, 200]
    assert len(plane.speed_knots) == 12
    assert len(plane.force_knots) == 3
