from datetime import datetime
from pathlib import Path

import pytest

from twin.kernel.errors import InputRefused, RecordingError
from twin.kernel.recording.folder import (
    LATEST_LINK,
    claim_run_folder,
    create_run_folder,
    discard_run_folder,
    recording_in,
)

NOON = datetime(2026, 1, 2, 12, 0, 0)


def test_runs_of_the_same_second_get_folders_of_their_own(tmp_path: Path):
    folders = [create_run_folder(tmp_path, "fig4", NOON) for _ in range(3)]
    assert [folder.name for folder in folders] == [
        "2026-01-02_120000",
        "2026-01-02_120000_2",
        "2026-01-02_120000_3",
    ]
    assert (tmp_path / "fig4" / LATEST_LINK).resolve() == folders[-1].resolve()


def test_a_discarded_run_was_never_the_latest(tmp_path: Path):
    folders = [create_run_folder(tmp_path, "fig4", NOON) for _ in range(11)]
    for last, before in zip(folders[:0:-1], folders[-2::-1], strict=True):
        discard_run_folder(last)
        assert not last.exists() and (tmp_path / "fig4" / LATEST_LINK).resolve() == before.resolve()
    discard_run_folder(folders[0])
    assert not list((tmp_path / "fig4").iterdir())


def test_a_run_with_a_recording_is_not_discarded(tmp_path: Path):
    folder = create_run_folder(tmp_path, "fig4", NOON)
    (folder / "run.mcap.partial").touch()
    discard_run_folder(folder)
    assert (tmp_path / "fig4" / LATEST_LINK / "run.mcap.partial").exists()


def test_a_folder_with_something_in_it_is_never_a_new_runs(tmp_path: Path):
    (tmp_path / "run.mcap").touch()
    with pytest.raises(RecordingError, match="never overwritten"):
        claim_run_folder(tmp_path)
    with pytest.raises(RecordingError, match="not empty"):
        claim_run_folder(tmp_path / "run.mcap")


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(InputRefused, match="cannot be created"):
        claim_run_folder(tmp_path / "file" / "inside")
    with pytest.raises(InputRefused, match="cannot be created"):
        create_run_folder(tmp_path / "file", "fig4", NOON)
    # where even root may not
    with pytest.raises(InputRefused, match="/sys/fig4: cannot be created"):
        create_run_folder(Path("/sys"), "fig4", NOON)


def test_a_recording_is_found_by_file_run_and_experiment(tmp_path: Path):
    older, newer = (create_run_folder(tmp_path, "fig4", NOON.replace(hour=hour)) for hour in (1, 2))
    for folder in (older, newer):
        (folder / "run.mcap").touch()
    assert recording_in(older / "run.mcap") == older / "run.mcap"
    assert recording_in(older) == older / "run.mcap"
    assert recording_in(tmp_path / "fig4") == newer / "run.mcap"
    (tmp_path / "fig4" / LATEST_LINK).unlink()
    assert recording_in(tmp_path / "fig4") == newer / "run.mcap"


def test_an_unfinished_recording_is_found_where_there_is_no_other(tmp_path: Path):
    (tmp_path / "run.mcap.partial").touch()
    assert recording_in(tmp_path) == tmp_path / "run.mcap.partial"


@pytest.mark.parametrize("misspelt", ["results/presing", "presing", "pressing"])
def test_a_misspelt_run_leads_to_the_one_that_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, misspelt: str):
    monkeypatch.chdir(tmp_path)
    create_run_folder(Path("results"), "pressing", NOON)
    with pytest.raises(RecordingError, match=f"^{misspelt}: no recording; did you mean 'results/pressing'\\?$"):
        recording_in(Path(misspelt))


def test_where_no_recording_is_a_sentence_says_so(tmp_path: Path):
    with pytest.raises(RecordingError, match="no recording"):
        recording_in(tmp_path)
