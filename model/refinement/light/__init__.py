"""The light of objects that may be in a known corner, and its linear inverse.

`corner_light` asks the engine of `render.batch` for it. `inverse` finds from it what a network sees beside
its input (`model.network.bounce_images`).
"""
