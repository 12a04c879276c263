"""A place for digitised figures of the paper: CSV curves with provenance in their head, see README.md here.

There are none: nobody has digitised a figure yet, and none is made up.
"""
