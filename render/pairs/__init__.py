"""What a camera has captured as data of scenes: presets of real corners, and datasets of real pairs.

`captured_corner` makes a preset of a capture of the empty corner. For a pair, a capture of the corner is
followed by one of a mirror that hangs on the relay wall: `truth` makes a depth map of it, `pairs` writes
datasets. Needs no Mitsuba; may import `scenegen` and `itof`.
"""
