"""What a recording holds: topics of named, unit-carrying fields."""

import re
from dataclasses import dataclass
from typing import Literal, get_args

Kind = Literal["double", "int", "bool"]

# field names become protobuf identifiers; topic names become `/name` with slashes inside
FIELD_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
TOPIC_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*")


@dataclass(frozen=True)
class Field:
    """One quantity of a topic.

    Attributes:
        name: a letter, then letters, digits and underscores: `F_ee_B`.
        size: number of values in every message; 1 is a scalar.
        kind: `double`, `int` (64 bit, for counts) or `bool`.
        unit: SI unit, `1` where there is none.
        meaning: one sentence for whoever opens the file, with frame and sign.

    Raises:
        ValueError: a name, size or kind that no message can have.
    """

    name: str
    size: int
    kind: Kind
    unit: str
    meaning: str

    def __post_init__(self) -> None:
        if not FIELD_NAME.fullmatch(self.name):
            raise ValueError(f"field name {self.name!r}: expected a letter, then letters, digits or _")
        if self.size < 1:
            raise ValueError(f"field {self.name}: size is {self.size}, expected 1 or more")
        if self.kind not in get_args(Kind):
            raise ValueError(f"field {self.name}: kind is {self.kind!r}, expected one of {get_args(Kind)}")


@dataclass(frozen=True)
class Topic:
    """A stream of messages of one shape at one period.

    Attributes:
        name: without the leading slash that it has in the file: `plant`, `drive/1`.
        fields: in the order of the columns of the rows handed to `Writer.write`.
        period: ticks from one message to the next; 1 is every tick.

    Raises:
        ValueError: a name, period or list of fields that no topic can have.
    """

    name: str
    fields: tuple[Field, ...]
    period: int

    def __post_init__(self) -> None:
        check_stream(self.name, self.period)
        names = [field.name for field in self.fields]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"topic {self.name}: expected fields of different names, got {names}")


def check_stream(name: str, period: int) -> None:
    """Refuse what no stream of messages can be: a `name` that is none, a `period` (ticks) of less than 1.

    Raises:
        ValueError: it is that.
    """
    if not TOPIC_NAME.fullmatch(name):
        raise ValueError(f"topic name {name!r}: expected words joined by slashes, such as drive/1")
    if period < 1:
        raise ValueError(f"topic {name}: period is {period} ticks, expected 1 or more")
