"""Exported files as tools that know nothing of twin read them."""

import csv
from pathlib import Path

import numpy as np


def csv_columns(path: Path) -> dict[str, np.ndarray]:
    """Heading -> numbers."""
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    return dict(zip(head, np.array(rows, dtype=float).T, strict=True))
