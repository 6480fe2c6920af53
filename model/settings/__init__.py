"""Settings of a training, as plain data: ``train_settings`` has them all, with files for the larger groups.

``keys`` knows what stands in TOML and on the command line, ``presets`` reads the files of data/training.
Imports neither torch nor another wing.
"""
