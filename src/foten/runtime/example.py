"""A texture that comes with the package, so that there is something to play before anything was recorded."""

from __future__ import annotations

from pathlib import Path

EXAMPLE = Path(__file__).with_name("example.foten")
"""A woven steel mesh, learned with the default recipe from `foten simulate steel-mesh-1`: no recording of anyone's."""
