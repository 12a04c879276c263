"""What Ctrl-C leaves in the folder of a run, and what is said of it."""

from pathlib import Path

from twin.kernel.process.recorded import left_behind


def test_what_was_recorded_is_named_and_an_empty_folder_goes(tmp_path: Path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.mcap").touch()
    assert left_behind(folder) == f"interrupted; the recording is complete: {folder}/run.mcap"
    (folder / "run.mcap").rename(folder / "run.mcap.partial")
    assert left_behind(folder) == f"interrupted; recorded until then: {folder}/run.mcap.partial"
    (folder / "run.mcap.partial").unlink()
    (folder / "notes").touch()
    assert left_behind(folder) == "interrupted before the first step; nothing is recorded" and folder.exists()
    (folder / "notes").unlink()
    left_behind(folder)
    assert not folder.exists()
