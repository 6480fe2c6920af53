"""The three-bounce light of simple solids in a known corner, and its linear inverse.

`three_bounces` computes the hidden light of `solids` in a `room`. `inverse` finds from it what a network sees
beside its input (`model.network.bounce_images`). Nothing here needs Mitsuba. Lengths are
metres in camera axes (x right, y down, z forward), with the camera at the origin.
"""
