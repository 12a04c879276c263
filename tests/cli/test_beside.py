"""What is done beside gives its answer or its error, and ends with the block that waits for it."""

import time

import pytest

from twin.cli.beside import Beside
from twin.errors import InputRefused


def test_the_answer_is_waited_for():
    def reckon() -> int:
        time.sleep(0.05)
        return 7

    with Beside(reckon) as beside:
        assert beside.answer() == 7


def test_its_error_is_raised_where_the_answer_is_asked_for():
    def refuse() -> None:
        raise InputRefused("no")

    with Beside(refuse) as beside, pytest.raises(InputRefused, match="no"):
        beside.answer()


def test_it_ends_when_the_block_is_interrupted():
    turns: list[None] = []

    def work() -> None:
        while len(turns) < 1000:
            turns.append(None)
            time.sleep(0.01)

    with pytest.raises(KeyboardInterrupt), Beside(work):
        time.sleep(0.05)
        raise KeyboardInterrupt
    # ten seconds of work; an interrupt arrives between two steps of Python
    assert 0 < len(turns) < 500
