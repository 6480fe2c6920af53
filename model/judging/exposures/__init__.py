"""Accuracy against exposure: what a network makes of scenes that a modelled camera measures.

`measuring` puts the camera between scene and network, `sweep` judges at each exposure or imperfection, and
`results` holds the numbers. May import what `model.judging` may, and that package.
"""
