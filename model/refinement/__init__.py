"""Refinement by rendering: simple solids whose three-bounce light (`model.bounces`) is that of a measurement.

`hidden_light` is what a measurement shows of the hidden light, `least_squares` moves solids until both agree,
and `refining` searches. Nothing here needs Mitsuba. Lengths are metres in camera axes (x right, y down, z
forward), with the camera at the origin.
"""
