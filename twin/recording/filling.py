"""Message records of one stride: a template repeated, with times and numbers put where they go, by compiled code.

Where the numbers of a row go is a table of places, (k, 3) int64: kind, column of the rows, offset in the record. Times
are those of the messages, in seconds and nanoseconds as a form has them.
"""

import numpy as np

from twin.compiled.function import carray
from twin.compiled.memory import copy, put
from twin.compiled.native import address_of, entry

DOUBLE, INTEGER, BOOL, SECONDS, NANOS = range(5)
"""Kinds of places: a double, a 64-bit integer, a byte that is 0 or 1, and a time in groups of 7 bits."""
SEQUENCE_AT, LOG_TIME_AT, PUBLISH_TIME_AT = 11, 15, 23
"""Where an MCAP Message record (https://mcap.dev/spec#message-op0x05) has what differs from one to the next."""
GROUPS = 5
"""Of 7 bits, in which a form has seconds and nanoseconds."""
SECOND = 10**9
FLOAT = np.dtype(np.float64)
ITEM = FLOAT.itemsize
NO_PLACES = np.empty((0, 3), dtype=np.int64)


@entry("int", "int", "int", "int", "int", "integers", "int", "doubles", "int", "integers", "int")
def _fill(records, count, stride, template, times, first_sequence, rows, step, places, number):
    at, row, place = carray(times, count), carray(rows, count * step), carray(places, number * 3)
    for i in range(count):
        to = records + i * stride
        copy(to, template, stride)
        put(to + SEQUENCE_AT, np.uint32(first_sequence + i))
        put(to + LOG_TIME_AT, at[i])
        put(to + PUBLISH_TIME_AT, at[i])
        for k in range(number):
            kind, column, where = place[3 * k], place[3 * k + 1], to + place[3 * k + 2]
            if kind == DOUBLE:
                put(where, row[i * step + column])
            elif kind == BOOL:
                put(where, np.uint8(row[i * step + column] != 0.0))
            elif kind == INTEGER:
                value = row[i * step + column]
                # what is beyond the integers, and NaN, has none to be compared with
                if not -(2.0**63) <= value < 2.0**63 or value != np.floor(value):
                    return 0
                put(where, np.int64(value))
            else:
                rest = at[i] // SECOND if kind == SECONDS else at[i] % SECOND
                for group in range(GROUPS):
                    more = 0x80 if group < GROUPS - 1 else 0
                    put(where + group, np.uint8(rest >> 7 * group & 0x7F | more))
    return 1


class Filling:
    """Makes records of rows.

    Args:
        template: one record, (stride,) uint8, without sequence number, times and numbers.
        places: see above.
    """

    def __init__(self, template: np.ndarray, places: np.ndarray):
        self.template, self._places = template, places
        self._template_at, self._places_at = template.ctypes.data, places.ctypes.data

    def fill(self, to: int, times: int, count: int, first_sequence: int, rows: np.ndarray) -> bool:
        """Write `count` records at address `to`; whether there is an integer wherever one goes.

        Args:
            times: address of theirs, ns, (count,) int64.
            first_sequence: number of the first record.
            rows: (count, columns) float64.
        """
        if rows.dtype != FLOAT or rows.strides[1] != ITEM or rows.strides[0] % ITEM:
            rows = np.ascontiguousarray(rows, dtype=FLOAT)
        stride, step = len(self.template), rows.strides[0] // ITEM
        # addresses all of them: an entry would look for arrays among its arguments
        whole: int = _fill.native.called(
            to, count, stride, self._template_at, times, first_sequence, address_of(rows[:1]), step,
            self._places_at, len(self._places),
        )  # fmt: skip
        return whole != 0

    def __reduce__(self) -> tuple[type["Filling"], tuple[np.ndarray, np.ndarray]]:
        """Of a recording that another process gets: addresses are others there."""
        return Filling, (self.template, self._places)

    def records(self, times: np.ndarray, first_sequence: int, rows: np.ndarray) -> np.ndarray | None:
        """A record for each of `times`, (n, stride) uint8; None: where an integer goes there is none.

        Args:
            times: ns, (n,) integer.
            first_sequence, rows: see `fill`.
        """
        times = np.ascontiguousarray(times, dtype=np.int64)
        records = np.empty((len(times), len(self.template)), dtype=np.uint8)
        whole = self.fill(records.ctypes.data, times.ctypes.data, len(times), first_sequence, rows)
        return records if whole else None
