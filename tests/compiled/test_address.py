import numpy as np
import pytest

from twin.compiled import address as of
from twin.compiled.address import address

ARRAYS = [
    np.empty(5),
    np.empty((4, 6))[1::2, 3:],
    np.empty(0, dtype=np.uint8),
    np.frombuffer(b"read only", dtype=np.uint8),
    np.empty(3, dtype=[("a", "i8"), ("b", "f4")])["b"],
    np.empty(4).view(np.recarray),
]


@pytest.mark.parametrize("array", ARRAYS)
def test_it_is_the_one_that_numpy_tells(array: np.ndarray) -> None:
    assert address(array) == array.ctypes.data


def test_it_is_asked_of_numpy_where_objects_are_laid_out_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(of, "_HEAD", of._HEAD + 8)
    assert of._way() is of._asked
