"""A small recording of every kind of field and a form, in several chunks, and the numbers that are in it."""

from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from hypothesis import strategies as st

from twin.kernel.recording.messages import BLANK_TIME, Field, MessageForm, Topic, blank_value
from twin.kernel.recording.reader import Recording
from twin.kernel.recording.writer import Writer

TICK = 1e-3
TICKS = 1500
SLICE = 100

DRIVE = (
    Field("theta_m", 1, "double", "rad", "motor angle"),
    Field("omega_m", 1, "double", "rad/s", "motor speed"),
)
PLANT = Topic(
    "plant",
    (
        Field("p_B", 3, "double", "m", "platform position in the base frame"),
        Field("F_ee_B", 3, "double", "N", "force by the robot on the environment"),
        # more than 127 bytes, so that the length before the values takes two
        Field("state", 18, "double", "1", "integrator state"),
    ),
    1,
)
ENCODER = Topic(
    "encoder",
    (Field("count_m", 3, "int", "1", "motor encoder"), Field("triggered", 1, "bool", "1", "force loop on")),
    2,
)
SCALE = Topic("scale", (Field("moved", 2, "bool", "1", "left, right"), Field("n", 1, "int", "1", "readings")), 40)
TOPICS = (PLANT, *(Topic(f"drive/{leg}", DRIVE, 1) for leg in (1, 2, 3)), ENCODER, SCALE)
TF = MessageForm(
    "tf",
    FrameTransform(
        timestamp=BLANK_TIME,
        child_frame_id="platform",
        translation=Vector3(x=blank_value(1), y=blank_value(0), z=blank_value(1)),
    ),
    2,
    20,
)
TF_ROWS = np.random.default_rng(0).normal(size=(TICKS // TF.period, TF.width))
METADATA = {"experiment": {"toml": "[task]\nname = 'press'\n"}, "twin": {"seed": "0"}}
ENDING = {"outcome": {"status": "done"}}


def rows_of(topic: Topic) -> np.ndarray:
    """Rows of `topic` over the sample recording, (n, width): no two alike, and the same in every run."""
    rng = np.random.default_rng(len(topic.name))
    n = len(range(0, TICKS, topic.period))
    columns = []
    for field in topic.fields:
        shape = (n, field.size)
        drawn = {
            "double": lambda shape=shape: rng.normal(size=shape),
            "int": lambda shape=shape: rng.integers(-(2**53), 2**53, size=shape).astype(float),
            "bool": lambda shape=shape: rng.integers(0, 2, size=shape).astype(float),
        }[field.kind]()
        columns.append(drawn)
    return np.concatenate(columns, axis=1)


def fill(writer: Writer) -> None:
    """Write the sample rows in slices, and two events."""
    for start in range(0, TICKS, SLICE):
        for topic in TOPICS:
            first, end = -(-start // topic.period), -(-(start + SLICE) // topic.period)
            writer.write(topic.name, first * topic.period, rows_of(topic)[first:end])
        pictures = slice(start // TF.period, (start + SLICE) // TF.period)
        writer.write("tf", start, TF_ROWS[pictures])
        if start == 700:
            writer.write_event(750, "info", "the trigger fired", "controller")
    writer.write_event(TICKS - 1, "warning", "the scale saturates", "scale")


def finished(path: Path) -> Path:
    """The sample recording, finished."""
    with Writer(path, TOPICS, TICK, METADATA, [TF]) as writer:
        fill(writer)
        for name, entries in ENDING.items():
            writer.write_metadata(name, entries)
    return path


def unfinished(path: Path) -> Path:
    """The sample recording, abandoned at its end."""
    writer = Writer(path, TOPICS, TICK, METADATA, [TF])
    fill(writer)
    return writer.abandon()


def truth() -> dict[str, np.ndarray]:
    """`topic.field` -> what `recording[topic.field]` has to be."""
    series = {}
    for topic in TOPICS:
        rows, start = rows_of(topic), 0
        for field in topic.fields:
            kind = {"double": "f8", "int": "i8", "bool": "?"}[field.kind]
            values = rows[:, start : start + field.size].astype(kind)
            series[f"{topic.name}.{field.name}"] = values[:, 0] if field.size == 1 else values
            start += field.size
    return series


def assert_beginning(recording: Recording, whole: dict[str, np.ndarray]) -> None:
    """`recording` holds the first ticks of `whole`, the same ones for all topics, and nothing else."""
    if not recording.streams:
        return
    assert recording.fields().keys() == whole.keys()
    ticks = len(recording["plant.p_B"])
    for topic in TOPICS:
        n = len(range(0, ticks, topic.period))
        np.testing.assert_array_equal(recording.time(topic.name), np.arange(n) * topic.period / 1000)
        for field in topic.fields:
            key = f"{topic.name}.{field.name}"
            np.testing.assert_array_equal(recording[key], whole[key][:n], strict=True)


kinds = st.sampled_from(["double", "int", "bool"])
names = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,8}", fullmatch=True)
texts = st.text(st.characters(codec="utf-8", categories=["L", "N", "P", "Zs"]), max_size=20)
units = st.sampled_from(["1", "N", "rad/s", "N m"])
fields = st.builds(Field, name=names, size=st.integers(1, 40), kind=kinds, unit=units, meaning=texts)
field_lists = st.lists(fields, min_size=1, max_size=5, unique_by=lambda field: field.name).map(tuple)
