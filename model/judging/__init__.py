"""Evaluation of a trained network on a dataset: numbers, tables, charts and the report page.

`evaluation` is the entry, and `exposures` for a modelled camera; `judging` runs the network over a split,
`results`, `groups` and `calibration` hold the numbers, the other modules write the report. May import
`model.prediction`, `model.data`, `model.network`, the run folder and the settings; not `model.training`.
"""
