"""How pictures look."""

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from twin.studies.analyse.text import SHADES
from twin.studies.figure import LESS_IS_BETTER


def lightness(color: object) -> float:
    """Relative luminance, ITU-R BT.709."""
    return float(np.dot(to_rgb(color), (0.2126, 0.7152, 0.0722)))  # type: ignore[arg-type]


def test_in_every_map_light_is_good():
    errors = [lightness(color) for color in colormaps[LESS_IS_BETTER](np.linspace(0.0, 1.0, 20))[:, :3]]
    assert errors == sorted(errors, reverse=True)
    # from hardly damped to well damped
    damping = [lightness(color) for color in SHADES]
    assert damping == sorted(damping)
