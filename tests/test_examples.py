"""What hypothesis draws: a user's run is CI's run, unless new examples are asked for."""

import pytest
from hypothesis import settings

from tests.conftest import USUAL, examples


def test_the_same_examples_are_drawn_everywhere_but_in_endurance(pytestconfig: pytest.Config):
    many = 20 if pytestconfig.getoption("--hypothesis-profile") == "endurance" else 1
    assert settings().derandomize is (many == 1)
    assert settings().max_examples == many * USUAL
    assert examples(15).max_examples == many * 15
    # of whatever profile the last conftest has loaded
    assert examples(15).derandomize is (many == 1)
