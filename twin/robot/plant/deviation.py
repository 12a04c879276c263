"""Force and position errors over a block of rows, accumulated by compiled code."""

import numpy as np
from numpy.typing import NDArray

from twin.kernel.compiled.function import carray, njit
from twin.kernel.compiled.native import entry

COLUMN_COUNT = 9
"""Number of evaluated values in a row: F_z by the platform on the surface, negative while pressing; p_B; p_ref_B;
whether force is controlled; its reference."""
RESULT_COUNT = 7


@njit(cache=True, inline="always")
def column_value(row, column):
    """Return the value of a column in a row of signals; NaN if the row has no such column."""
    return row[column] if column >= 0 else np.nan


@entry("int", "doubles", "int", "int", "integers", "int", "doubles", "doubles")
def _add_up(rows, count, width, columns, touched, found, off):
    table, column = carray(rows, (count, width)), carray(columns, COLUMN_COUNT)
    sums, squares = carray(found, RESULT_COUNT), carray(off, count)
    sums[:] = 0.0
    sums[3] = -np.inf
    sums[5] = sums[6] = -1.0
    controlled = 0
    for i in range(count):
        row = table[i]
        F_z = -column_value(row, column[0])
        if F_z > sums[3]:
            sums[3], sums[4] = F_z, i
        for axis in range(3):
            astray = column_value(row, column[1 + axis]) - column_value(row, column[4 + axis])
            sums[axis] += astray * astray
        if F_z > 0.0 and sums[5] < 0.0:
            sums[5] = i
        if column_value(row, column[7]) > 0.0:
            if sums[6] < 0.0:
                sums[6] = i
            if touched or sums[5] >= 0.0:
                error = column_value(row, column[8]) - F_z
                squares[controlled] = error * error
                controlled += 1
    return controlled


class DeviationSums:
    """Sums of force and position errors over one block of at most `size` signal rows.

    Attributes:
        squares: sums of the squares of p_B - p_ref_B, added in the order of the rows, (3,) m^2.
        off: squares of the controlled pressing force minus its reference, from the first touch on, (n,) N^2.
        peak, place: largest pressing force (N) and its row.
        touch, trigger: first row with contact, and first row with controlled force; -1 if missing.
    """

    def __init__(self, size: int) -> None:
        self._found, self._off = np.zeros(RESULT_COUNT), np.empty(size)

    def add_block(self, rows: NDArray[np.float64], columns: NDArray[np.int64], touched: bool = False) -> None:
        """Compute the sums of force and position errors of a block of rows.

        Args:
            rows: (n, width), n at most `size`.
            columns: positions of the `COLUMN_COUNT` values in a row, (9,); negative for a missing value, taken as NaN.
            touched: whether there was contact in a previous block.
        """
        rows = np.ascontiguousarray(rows)
        controlled = _add_up(rows, *rows.shape, columns, touched, self._found, self._off)
        self.squares, self.off = self._found[:3], self._off[:controlled]
        self.peak, self.place = float(self._found[3]), int(self._found[4])
        self.touch, self.trigger = int(self._found[5]), int(self._found[6])
