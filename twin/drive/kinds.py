"""The types of FMI 3.0 that hold numbers, by which a variable of any version is kept."""

KINDS = ("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Boolean")
"""A variable's `kind` is the index; `variable` says which of them the types of other versions are."""

ITEM_SIZES = (8, 4, 1, 1, 2, 2, 4, 4, 8, 8, 1)
"""Bytes of one value of each of `KINDS`."""
