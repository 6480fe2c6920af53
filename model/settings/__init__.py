"""Settings of a training, as plain data: one file for each group; ``train_settings`` has them all.

``keys`` knows what stands in TOML and on the command line, ``presets`` reads the files of data/training.
Imports neither torch nor another wing.
"""
