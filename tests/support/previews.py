"""What the tests of previews share: which scenes are rendered, and pictures of scenes."""

import numpy as np

RENDERED = ("000000", "000001", "000003")  # of the nine scenes of the fixture `corners`


def grey_view(scene, width, height):
    """Stands in where no view is looked at, to save Blender's second."""
    return np.full((height, width, 3), 128, np.uint8)


def orange(picture):
    """(N, 2) rows and columns of the pixels that only the hidden object can have coloured."""
    red, green, blue = (picture[..., channel].astype(int) for channel in range(3))
    return np.argwhere((red > 100) & (red > 1.5 * green) & (green > blue + 20))
