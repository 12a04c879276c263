"""Compiled code: decorators for its source, storage of object files, calls from Python and C."""
