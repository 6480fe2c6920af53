"""EXR files of images and transients: `image`, `depth_map` and `transient`.

`header` checks the structure of a file before OpenEXR, which only `library` imports, opens it. May import
the other modules of `itof`.
"""
