"""Refinement by rendering: simple solids whose three-bounce light is that of a measurement.

`light` computes that of solids in a corner, `hidden_light` is what a measurement shows of it,
`least_squares` moves solids until both agree, and `refining` searches. Lengths are
metres in camera axes (x right, y down, z forward), with the camera at the origin.
"""
