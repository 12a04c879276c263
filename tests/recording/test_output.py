import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from twin.recording.errors import RecordingFailed
from twin.recording.output import Output
from twin.recording.reader import read
from twin.recording.writer import Writer

from . import samples
from .samples import METADATA, TF, TICK, TOPICS


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """The kernel lets no file of this process grow beyond `size` bytes: writes come back short, then fail."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_recording_that_may_not_grow_says_so_and_keeps_its_complete_chunks(
    share: float, unfinished: Path, tmp_path: Path, truth: dict[str, np.ndarray]
) -> None:
    limit = int(share * unfinished.stat().st_size)
    with (
        largest_file(limit),
        pytest.raises(RecordingFailed, match=r"run\.mcap\.partial: recording stopped: File too large; the "),
        Writer(tmp_path / "run.mcap", TOPICS, TICK, METADATA, [TF]) as writer,
    ):
        samples.fill(writer)
    recording = read(tmp_path / "run.mcap.partial")
    samples.assert_beginning(recording, truth)
    assert recording.streams if share > 0.2 else True
    # cut back to its last complete record, the file has nothing after it
    assert recording.note.endswith("0 bytes after that are incomplete")


def test_a_recording_that_fails_at_its_index_keeps_every_row(
    unfinished: Path, tmp_path: Path, truth: dict[str, np.ndarray]
) -> None:
    with (
        largest_file(unfinished.stat().st_size + 10),
        pytest.raises(RecordingFailed, match="File too large"),
        Writer(tmp_path / "run.mcap", TOPICS, TICK, METADATA, [TF]) as writer,
    ):
        samples.fill(writer)
    recording = read(tmp_path / "run.mcap.partial")
    samples.assert_beginning(recording, truth)
    assert len(recording["plant.p_B"]) == samples.TICKS


def test_a_full_disk_is_named_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "run.mcap.partial").symlink_to("/dev/full")
    with pytest.raises(RecordingFailed) as caught:
        Writer(tmp_path / "run.mcap", TOPICS, TICK, METADATA, [TF])
    path = tmp_path / "run.mcap.partial"
    assert str(caught.value) == (
        f"{path}: recording stopped: No space left on device; the 0 bytes already written stay readable"
    )
    assert caught.value.exit_code == 3


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingFailed, match=r"nowhere/run\.mcap\.partial: cannot be created: No such file"):
        Writer(tmp_path / "nowhere" / "run.mcap", TOPICS, TICK, METADATA, [TF])


def test_the_error_that_stopped_the_run_is_not_hidden_by_the_disk(tmp_path: Path) -> None:
    with (
        largest_file(2000),
        pytest.raises(ZeroDivisionError) as caught,
        Writer(tmp_path / "run.mcap", TOPICS, TICK, METADATA, [TF]) as writer,
    ):
        writer.write("drive/1", 0, np.random.default_rng(0).normal(size=(500, 2)))
        raise ZeroDivisionError
    assert "recording stopped: File too large" in caught.value.__notes__[0]


def test_an_interrupt_halfway_through_a_record_leaves_no_half_record(tmp_path: Path) -> None:
    class Interrupting:
        """A file that is interrupted after it has written a part."""

        def __init__(self, output: Output) -> None:
            assert output._file is not None
            self.file = output._file

        def write(self, data: bytes) -> int:
            self.file.write(data[:3])
            raise KeyboardInterrupt

        def __getattr__(self, name: str) -> object:
            return getattr(self.file, name)

    output = Output(tmp_path / "run.mcap")
    output.append(b"whole")
    output._file = Interrupting(output)  # type: ignore[assignment]
    with pytest.raises(KeyboardInterrupt):
        output.append(b"interrupted")
    assert output.partial.read_bytes() == b"whole"
    assert output.closed
