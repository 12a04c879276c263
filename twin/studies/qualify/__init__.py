"""Drives on a test bench: what one does with known commands and loads, and how several do in the same experiment."""
