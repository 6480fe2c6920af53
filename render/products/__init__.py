"""What is made of renders once they are there; nothing here loads Mitsuba.

Here: conversion to other frequencies, y-tal captures, movies, verification, and the preview of a dataset
(contact sheet, distributions, card). May import `render.farm` for its locks, and the settings; not
`render.transport`.
"""
