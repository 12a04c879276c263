"""Digitised figures of the paper: CSV curves with provenance in their head, see README.md here.

There are none: no figure has been digitised yet, and none is made up.
"""
