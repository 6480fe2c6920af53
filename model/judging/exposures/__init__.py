"""Accuracy against exposure: what a network makes of scenes that a modelled camera measures.

`sweep` judges at each exposure or imperfection, and `results` holds the numbers. May import what
`model.judging` may, and that package.
"""
