"""Compiled code: what it is written with, where it is kept, how it is called."""
