"""From rendered scenes to batches on the computing device.

Here: reading renders, the shards made of them, the order of an epoch, memory or streaming, augmentation, and
the constants of the input channels. May import `model.network` and the settings; nothing that trains or
predicts.
"""
