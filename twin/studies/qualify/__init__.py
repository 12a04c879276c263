"""Drives on a test bench: the response of one to known commands and loads, and comparison in the same experiment."""
