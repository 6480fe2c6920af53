"""What a camera sees of the two walls, exactly: their edges on the film, and the free parts of pixels.

Both engines use it. Numpy only; may import `scenegen`.
"""

from render.walls.corners import Corners, Rectangles
from render.walls.pixel_lines import PixelLines, crossed_pixels, free_nodes

__all__ = ["Corners", "PixelLines", "Rectangles", "crossed_pixels", "free_nodes"]
