"""What is made of finished renders. Nothing here loads Mitsuba.

Here: conversion to other frequencies, deletion of transients, y-tal captures, movies, plots, verification,
and the preview of a dataset (contact sheet, distributions, card). May import the locks of `render.farm` and
the settings; not `render.transport`.
"""
