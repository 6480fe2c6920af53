"""The batched engine: the light of three bounces of many scenes at once.

`light.BatchedLight` is the way in. Nothing here starts Blender or reads a file; only `kernels` knows DrJit.
"""
