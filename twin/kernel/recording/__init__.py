"""MCAP in and out: `Writer` records topics of numbers, `read` gives them back as arrays.

`layout` says what a recording holds, `writer` and `reader` are the two doors, `recording` is what comes out
and `errors` what can go wrong; the rest is not for callers.
"""
