"""The report of an evaluation: its page, tables, charts and pictures.

`page` writes it. May import `model.judging`, whose modules do not import this package, except its entry
`evaluation`.
"""
