"""What the commands of `cli` share: how they end (`endings`), and their options (`options`).

Imports click, `scenegen` and the training settings, which are plain data; nothing that computes.
"""
