"""Records of options: their fields are options of the command, and arguments of the function that is called."""

import inspect
from dataclasses import dataclass
from typing import Annotated

from twin.studies.command import Option, study


@dataclass(frozen=True)
class SpeedOptions:
    speed: Annotated[float, Option("Speed.")] = 1.0
    slow: Annotated[bool, Option("Slow.")] = False


@study()
def moved(path: Annotated[str, Option("Path.")], speeds: SpeedOptions, last: Annotated[int, Option("Last.")] = 3):
    return path, speeds, last


def test_the_fields_of_a_record_are_options_in_its_place():
    own = inspect.signature(moved).parameters
    assert list(own) == ["path", "speed", "slow", "last"]
    assert own["speed"].default == 1.0 and own["path"].default is inspect.Parameter.empty
    assert own["speed"].annotation == Annotated[float, Option("Speed.")]


def test_a_study_gets_its_record_of_what_is_asked():
    asked = {"path": "a", "speed": 2.0, "slow": True, "last": 4}
    assert moved(**asked) == ("a", SpeedOptions(2.0, True), 4)  # type: ignore[arg-type]
    assert moved(**{"path": "a"}) == ("a", SpeedOptions(), 3)  # type: ignore[arg-type]


def test_a_study_without_records_stays_the_function_that_it_is():
    def plain(path: str): ...

    assert study()(plain) is plain
