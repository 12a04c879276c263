import numpy as np
import pytest

from twin.errors import InputRefused
from twin.studies.reference.series import series_of


def test_a_signal_is_held_or_on_lines_and_a_repeated_time_is_a_jump():
    found = series_of(b'"time","a.b"\n0,0\n1,2\n1,5\n2,5\n', "x")
    t = np.array([-1.0, 0.0, 0.5, 1.0, 1.5, 9.0])
    assert found.linear("a.b", t).tolist() == [0.0, 0.0, 1.0, 5.0, 5.0, 5.0]
    assert found.held("a.b", t).tolist() == [0.0, 0.0, 0.0, 5.0, 5.0, 5.0]


def test_a_time_that_rounding_puts_below_a_row_sees_that_row():
    found = series_of(b"time,a\n0,0\n0.3,1\n0.6,2\n", "x")
    assert found.held("a", 0.1 * np.array([3, 6]))[0] == 1.0 and 0.1 * 3 != 0.3
    assert found.held("a", np.array([np.nextafter(0.3, 0.0)])).tolist() == [1.0]


def test_truth_values_are_numbers_and_words_are_left_out():
    found = series_of(b"time,a,s,v\n0,true,Set me!,1 2\n1,False,none,3 4\n", "x")
    assert found.signals["a"].tolist() == [1.0, 0.0] and found.others == ("s", "v")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "empty"),
        (b"time,a\n", "0 rows of numbers"),
        (b"time,a\n0,1\n1\n", "1 field, expected 2"),
        (b"time,a\n0,1\nx,2\n", "x line 3: time 'x'"),
        (b"time,a\n0,1\nnan,2\n", "time 'nan'"),
        (b"time,a\n0,1\n2,1\n1,1\n", "x line 4: time falls from 2 to 1 s"),
        (b"time,a\n0,1\n1,nan\n", "x line 3: a is 'nan'"),
        (b"time,a\n0,inf\n1,1\n", "x line 2: a is 'inf'"),
        (b"time,a,a\n0,1,1\n1,1,1\n", "two columns are named 'a'"),
        (b"a" + b",a" * 3000 + b"\n", "3,001 columns"),
        (b"PK\x03\x04", "ZIP archive"),
        (b"time,a\n0,\xff\n", "not UTF-8"),
    ],
)
def test_a_table_with_mistakes_is_refused_with_the_line(content: bytes, told: str):
    with pytest.raises(InputRefused) as refused:
        series_of(content, "x")
    assert told in str(refused.value)
