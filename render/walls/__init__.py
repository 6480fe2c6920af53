"""What a camera sees of the two walls, exactly: their edges on the film, and the free parts of pixels.

`corners` has the edges, `pixel_lines` the parts. Both engines use them. Numpy only; may import `scenegen`.
"""
