"""How far a recording reaches, by its chunks alone."""

from pathlib import Path

import pytest

from twin.recording.extent import last_time
from twin.recording.reader import read
from twin.recording.recording import Recording


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
