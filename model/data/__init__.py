"""From rendered scenes to batches on the computing device.

`renders` reads a scene, `shards` and `pieces` store all scenes in a form that is fast to read, `feed`
delivers them in batches, `augmentation` changes them, `channel_scaling` fits the constants of the input
channels. May import `itof`, `scenegen`, `model.network` and `model.settings`; no other sub-package of
`model`.
"""
