"""The run folder: the files that training writes and that everything else reads to use a trained network.

``run_config`` (run.json), ``weights`` (best.safetensors), ``history`` (history.csv); `model.training` adds
the checkpoint. Each file contains its own checksum (`disk.checksums`), so a kill between the writing of two
files leaves a run that can be used. May import `model.network` and `model.settings`.
"""
