"""Refinement by rendering: simple solids whose three-bounce light is that of a measurement.

`bounce` computes the hidden light of `solids` in a `room`, `hidden_light` is what a measurement shows of it,
`least_squares` moves solids until both agree, and `refining` searches. Nothing here needs Mitsuba. Lengths
are metres in camera axes (x right, y down, z forward), with the camera at the origin.
"""
