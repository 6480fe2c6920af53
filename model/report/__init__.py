"""Judging a trained network on a dataset: numbers, tables, charts and the report page.

Here: the evaluation of a split, groups of scenes, the sweep of mask thresholds, and the files that are
written. May import `model.prediction`, `model.data` and `model.network`; not `model.training`.
"""
