"""What the commands of `cli` share: how they end (`endings`), their options (`options`), how
they print results (`results`), and the question before they delete something (`confirmation`).

Imports click, `scenegen` and the training settings, which are plain data; nothing that computes.
"""
