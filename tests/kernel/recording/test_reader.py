import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mcap.writer import Writer as McapWriter

from tests.conftest import examples
from twin.kernel.errors import InputRefused, RecordingError, UnknownSeries
from twin.kernel.recording.messages import Field, Topic, descriptor_set
from twin.kernel.recording.reader import Recording, last_time, read
from twin.kernel.recording.scan import Event
from twin.kernel.recording.writer import Writer

from . import samples
from .samples import DRIVE, TICK, TICKS


def test_a_finished_recording_gives_back_every_value_and_time(finished: Path, truth: dict[str, np.ndarray]) -> None:
    recording = read(finished)
    samples.assert_beginning(recording, truth)
    assert len(recording["plant.p_B"]) == TICKS
    assert (recording.complete, recording.note) == (True, "")


@examples(50)
@given(arrays(np.uint64, (7, 2), elements=st.integers(0, 2**64 - 1)))
def test_doubles_come_back_bit_for_bit_whatever_they_are(
    tmp_path_factory: pytest.TempPathFactory, bits: np.ndarray
) -> None:
    rows = bits.view(np.float64)
    rows[0] = np.nan, -np.inf
    rows[1] = -0.0, 5e-324
    path = tmp_path_factory.mktemp("bits") / "run.mcap"
    with Writer(path, [Topic("drive/1", DRIVE, 1)], TICK, {}) as writer:
        writer.write("drive/1", 0, rows)
    recording = read(path)
    found = np.stack([recording["drive/1.theta_m"], recording["drive/1.omega_m"]], axis=1)
    assert found.tobytes() == rows.tobytes()


def test_fields_come_with_size_kind_unit_and_meaning_from_the_file(finished: Path) -> None:
    fields = read(finished).fields()
    force = Field("F_ee_B", 3, "double", "N", "force by the robot on the environment")
    assert fields["plant.F_ee_B"] == force
    assert fields["encoder.triggered"] == Field("triggered", 1, "bool", "1", "force loop on")


def test_metadata_and_events_come_back(finished: Path) -> None:
    recording = read(finished)
    assert recording.metadata == {**samples.METADATA, **samples.ENDING}
    assert recording.events == [
        Event(0.75, "info", "the trigger fired", "controller"),
        Event(1.499, "warning", "the scale saturates", "scale"),
    ]


def test_metadata_of_one_name_is_joined(tmp_path: Path) -> None:
    with Writer(tmp_path / "run.mcap", [], TICK, {"run": {"status": "running", "seed": "1"}}) as writer:
        writer.write_metadata("run", {"status": "done"})
    assert read(tmp_path / "run.mcap").metadata == {"run": {"status": "done", "seed": "1"}}


def test_a_topic_without_messages_reads_as_empty_arrays_of_its_shape(tmp_path: Path) -> None:
    topics = [Topic("drive/1", DRIVE, 1), samples.PLANT]
    with Writer(tmp_path / "run.mcap", topics, TICK, {}) as writer:
        writer.write("drive/1", 0, np.zeros((3, 2)))
    recording = read(tmp_path / "run.mcap")
    assert (recording["plant.p_B"].shape, recording.time("plant").shape) == ((0, 3), (0,))


def test_an_abandoned_recording_reads_to_its_last_row_and_says_that_it_is_unfinished(
    unfinished: Path, truth: dict[str, np.ndarray]
) -> None:
    recording = read(unfinished)
    samples.assert_beginning(recording, truth)
    assert len(recording["plant.p_B"]) == TICKS
    assert not recording.complete
    assert recording.note == (
        "unfinished recording: read up to 1.499 s, its last complete chunk; 0 bytes after that are incomplete"
    )


def test_a_folder_stands_for_the_latest_run_in_it(finished: Path, tmp_path: Path) -> None:
    for run in ("2026-01-01_120000", "2026-01-02_120000"):
        (tmp_path / run).mkdir()
    shutil.copy(finished, tmp_path / run / "run.mcap")
    assert read(tmp_path / run).path == read(str(tmp_path)).path == tmp_path / run / "run.mcap"
    with pytest.raises(RecordingError, match=r"no recording; expected an \.mcap file, a run's folder"):
        read(tmp_path / "2026-01-01_120000")


def test_a_misspelt_series_is_refused_with_the_nearest_name(finished: Path) -> None:
    recording = read(finished)
    with pytest.raises(UnknownSeries, match=r"no series 'plant\.p_b'; did you mean 'plant\.p_B'"):
        recording["plant.p_b"]
    with pytest.raises(KeyError, match="no topic 'encoders'; did you mean 'encoder'"):
        recording.time("encoders")
    with pytest.raises(InputRefused, match="no series 'zzz'; it holds plant"):
        recording["zzz"]


def test_a_missing_recording_is_named_together_with_what_is_left_of_it(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"run\.mcap: cannot be read: No such file or directory$"):
        read(tmp_path / "run.mcap")
    (tmp_path / "run.mcap.partial").touch()
    with pytest.raises(RecordingError, match=r"unfinished recording exists: run\.mcap\.partial$"):
        read(tmp_path / "run.mcap")


@pytest.mark.parametrize(("content", "what"), [(b"", "an empty file"), (b"time,F_z\n0,5\n", "not an MCAP file")])
def test_a_file_that_is_no_recording_is_told_apart(content: bytes, what: str, tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=rf"run\.mcap: {what}, expected a recording"):
        read(tmp_path / "run.mcap")


# nothing, as protobuf writes zeros; one field of two; both in the other order
@pytest.mark.parametrize("value", [b"", b"\x09" + bytes(8), b"\x11" + bytes(8) + b"\x09" + bytes(8)])
def test_messages_that_do_not_fill_the_layout_of_their_schema_are_refused_rather_than_misread(
    value: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, enable_data_crcs=True)
        writer.start()
        schema = writer.register_schema("twin.Drive", "protobuf", descriptor_set("twin.Drive", DRIVE))
        channel = writer.register_channel("/drive/1", "protobuf", schema)
        writer.add_message(channel, 0, value, 0)
        writer.finish()
    with pytest.raises(RecordingError, match=r"foreign\.mcap: not a recording that twin wrote: messages"):
        read(path)


def test_a_file_that_mcap_and_protobuf_wrote_in_this_layout_is_read_with_all_its_crcs(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, enable_data_crcs=True)
        writer.start()
        schema = writer.register_schema("twin.Drive", "protobuf", descriptor_set("twin.Drive", DRIVE))
        channel = writer.register_channel("/drive/1", "protobuf", schema)
        for number in range(3):
            value = b"\x09" + struct.pack("<d", number + 0.5) + b"\x11" + struct.pack("<d", -number - 1.0)
            writer.add_message(channel, 10**6 * number, value, 10**6 * number, number)
        writer.finish()
    recording = read(path)
    assert recording.complete
    assert recording["drive/1.theta_m"].tolist() == [0.5, 1.5, 2.5]
    assert recording["drive/1.omega_m"].tolist() == [-1.0, -2.0, -3.0]


def test_a_recording_of_pictures_alone_is_refused(tmp_path: Path) -> None:
    with Writer(tmp_path / "pictures.mcap", [], TICK, {}, [samples.TF]) as writer:
        writer.write("tf", 0, samples.TF_ROWS)
    with pytest.raises(
        RecordingError, match=r"pictures\.mcap: not a recording that twin wrote: it has no topic of twin"
    ):
        read(tmp_path / "pictures.mcap")


def test_a_recording_of_another_tool_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, enable_data_crcs=True)
        writer.start()
        schema = writer.register_schema("Pose", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/pose", "json", schema), 0, b"{}", 0)
        writer.finish()
    with pytest.raises(RecordingError, match=r"foreign\.mcap: not a recording that twin wrote"):
        read(path)


def test_the_last_time_is_that_of_the_last_message(force_position: Recording):
    assert last_time(force_position.path) == force_position.time("plant")[-1]


@pytest.mark.parametrize("share", [0.01, 0.3, 0.9])
def test_a_torn_recording_reaches_to_its_last_complete_chunk(force_position: Recording, tmp_path: Path, share: float):
    whole = force_position.path.read_bytes()
    torn = tmp_path / "run.mcap.partial"
    torn.write_bytes(whole[: int(share * len(whole))])
    recording = read(torn)
    ends = [recording.time(topic)[-1] for topic, stream in recording.streams.items() if len(stream.records)]
    assert last_time(torn) == max(ends)


def test_a_recording_without_a_chunk_reaches_nowhere(force_position: Recording, tmp_path: Path):
    torn = tmp_path / "run.mcap.partial"
    torn.write_bytes(force_position.path.read_bytes()[:100])
    assert last_time(torn) is None


def test_a_recording_is_read_like_a_dictionary(finished: Path, truth: dict[str, np.ndarray]) -> None:
    recording = read(finished)
    assert "plant.p_B" in recording and "plant.q" not in recording and 0 not in recording
    assert list(recording) == list(recording.keys()) == list(recording.fields())
    whole = dict(recording)
    assert set(whole) == set(truth) and all(np.array_equal(whole[name], truth[name]) for name in truth)
    with pytest.raises(UnknownSeries, match="no series 0; it holds"):
        recording[0]  # type: ignore[index]
