"""Every record has one form in JSON: its declared keys, else its fields; no number that JSON does not know."""

import json
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from twin.kernel.serialise import to_dict


class Colour(StrEnum):
    RED = "red"


class Point(NamedTuple):
    x: float
    name: str = "here"


@dataclass(frozen=True)
class Swing:
    mean: float
    at: Point
    errors: dict[str, float]
    pair: tuple[float, float]

    @property
    def grows(self) -> bool:
        return self.mean > 0.0

    JSON_KEYS = "mean_W=mean x=at.x error_N=errors.F_z second=pair.1 grows"


def test_declared_keys_have_the_values_at_their_paths_in_their_order():
    found = to_dict(Swing(1.0, Point(2.0), {"F_z": np.inf}, (3.0, 4.0)))
    assert list(found.items()) == [("mean_W", 1.0), ("x", 2.0), ("error_N", None), ("second", 4.0), ("grows", True)]


@dataclass(frozen=True)
class Plain:
    path: Path
    point: Point
    values: np.ndarray
    colour: Colour
    none: None = None


def test_other_records_have_their_fields_and_everything_can_be_json():
    found = to_dict({"one": Plain(Path("a/b"), Point(np.float64(1.5)), np.array([[1.0, np.nan]]), Colour.RED)})
    assert json.loads(json.dumps(found, allow_nan=False)) == {
        "one": {
            "path": "a/b",
            "point": {"x": 1.5, "name": "here"},
            "values": [[1.0, None]],
            "colour": "red",
            "none": None,
        }
    }


def test_what_has_no_form_is_named():
    with pytest.raises(TypeError, match="object has no form in JSON"):
        to_dict([object()])
