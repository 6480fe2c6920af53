"""The batched engine: the light of three bounces of many scenes at once.

`light.BatchedLight` renders images, `candidates.CandidateLight` what searches compare with a measurement;
`expected_light` says what to expect in a corner.
Nothing here starts Blender or reads a file; only `kernels` knows DrJit.
"""
