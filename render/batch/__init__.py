"""The batched engine: the light of three bounces of many scenes at once.

`light.BatchedLight` renders images, `candidates.CandidateLight` what searches compare with a measurement.
Nothing here starts Blender or reads a file; only `kernels` knows DrJit.
"""
