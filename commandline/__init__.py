"""The commands, one file for each group, and what they share.

Shared: how commands end (`endings`), options (`options`), how results are printed (`results`), and the
question before something is deleted (`confirmation`). Only this package and `cli` import click.
"""
