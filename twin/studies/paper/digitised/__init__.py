"""Digitised figures of the paper: CSV curves with provenance in their head, see README.md here.

The folder has no curves yet: no figure has been digitised, and invented curves are not accepted.
"""
