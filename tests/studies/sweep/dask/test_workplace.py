import time
from pathlib import Path

import pytest

from twin.runs.guard.limits import Limits
from twin.studies.sweep.dask import depot, workplace
from twin.studies.sweep.dask.parcel import Parcel
from twin.studies.sweep.dask.versions import difference, versions


def test_a_place_that_nobody_uses_any_more_is_given_up(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(workplace, "IDLE", 0.01)
    parcel = Parcel(root / "experiments" / "fig4_position.toml")
    depot.keep(parcel.contents)
    errand = workplace.Errand("mine", versions(), parcel.label, "none", Limits(), "")
    workplace._places["mine"] = place = workplace.Place(errand, str(tmp_path))
    assert list(tmp_path.glob("twin_place_*"))
    place.ran([])
    deadline = time.monotonic() + 30.0
    while "mine" in workplace._places or list(tmp_path.glob("twin_place_*")):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    # a batch that arrives in that moment comes back undone
    assert place.ran([(1, None, ())]) == []


def test_versions_that_differ_are_named_and_equal_ones_are_not():
    ours = {"numba": "0.61.0", "Python": "3.11"}
    assert difference("worker a", ours, ours) == ""
    told = difference("worker a", {"Python": "3.11"}, ours)
    assert told == "worker a has numba none, this machine has 0.61.0"
