"""Limits of speed and force at which a rendering fades or stops growing, and a hand rests."""

FADE_SPEED = 2.0  # mm/s; a texture fades below this, or below its trained range where that ends higher
FADE_FORCE = 0.1  # N
MOVING_SPEED, MOVING_FORCE = (
    5.0,
    0.1,
)  # mm/s and N below which a hand counts as at rest: nothing is learned or judged there
EXTRAPOLATION_LIMIT = 2.0  # times the trained range's end, that the level grows to, where it does; and at least to
REACH_SPEED = 400.0  # mm/s
REACH_FORCE = 6.0  # N
