"""Tolerances of the alarm: the shipped files belong to their experiments, and are computed the same again."""

import dataclasses
from pathlib import Path

import pytest

from tests.studies.shadow.robots import EXPERIMENTS, shipped_fleet
from twin.robot.assembly.load import load_experiment
from twin.studies.shadow import tolerances
from twin.studies.shadow.alarm import CHANNELS, RateTolerances, Tolerances, tolerances_at
from twin.studies.shadow.fleet import fleet_limits
from twin.studies.shadow.tolerances import (
    SHIPPED_FOLDER,
    finds_faults,
    fleet_digest,
    read_tolerances,
    tolerances_of,
    write_tolerances,
)

NAMES = sorted(path.stem for path in SHIPPED_FOLDER.glob("*.json"))


def shipped(name: str) -> RateTolerances:
    found, where = tolerances_of(shipped_fleet(EXPERIMENTS / f"{name}.toml"))
    assert where == "shipped"
    return found


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_file_belongs_to_its_experiment_and_has_the_controllers_rate(name: str):
    assert 500.0 in shipped(name) and len(NAMES) == 7


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fig4_force_position", "massage"])
def test_a_rate_is_shipped_only_if_it_finds_a_softer_spring_and_a_dead_drive(name: str):
    fleet, limits = shipped_fleet(EXPERIMENTS / f"{name}.toml"), shipped(name)[500.0]
    assert finds_faults(fleet, limits)
    wider = {name: 2.5 * value for name, value in limits.tolerance.items()}
    assert not finds_faults(fleet, dataclasses.replace(limits, tolerance=wider))


def test_a_value_that_was_identified_does_not_vary_and_others_scale_with_the_experiment(tmp_path: Path):
    source = tmp_path / "identified.toml"
    own = 'k_s_Nm_per_rad = { value = 0.9, source = "identified from a.csv: +- 0.001" }'
    source.write_text(f'extends = "{EXPERIMENTS / "pressing.toml"}"\n[plant]\n{own}\n')
    keys = {setting.partition("=")[0] for one in shipped_fleet(source).robots for setting in one}
    assert "plant.k_s_Nm_per_rad" not in keys and "plant.backlash_deg" in keys
    soft = shipped_fleet(EXPERIMENTS / "pressing.toml", ("plant.k_s_Nm_per_rad=0.5",))
    drawn = [float(one.partition("=")[2]) for robot in soft.robots for one in robot if "k_s" in one]
    assert 0.48 <= min(drawn) < 0.485 and 0.515 < max(drawn) <= 0.52


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pressing", "tapping"])
def test_shipped_tolerances_are_computed_the_same_again(name: str):
    (again,), stored = fleet_limits(shipped_fleet(EXPERIMENTS / f"{name}.toml")), shipped(name)[500.0]
    for kind, values in dataclasses.asdict(again).items():
        assert values == pytest.approx(getattr(stored, kind), rel=1e-6, nan_ok=True)


def test_tolerances_of_another_experiment_are_computed_once_and_cached_with_progress(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(tolerances, "finds_faults", lambda fleet, limits, every: every < 5)
    fleet = shipped_fleet(EXPERIMENTS / "tapping.toml", ("plant.k_s_Nm_per_rad=1.01",))
    fleet, said = dataclasses.replace(fleet, robots=fleet.robots[:1], corners=fleet.corners[:1]), []

    def progress(what: str, share: float | None = None) -> None:
        said.append((what, share))

    computed, origin = tolerances_of(fleet, progress)
    assert origin == "computed" and list(computed) == [500.0, 250.0]
    assert said == [(f"tolerances of the alarm: healthy robot {k} of 2", share) for k, share in ((1, 0.0), (2, 0.5))]
    again, origin = tolerances_of(fleet, progress)
    assert origin == "cached" and len(said) == 2
    for rate, one in again.items():
        assert one.tolerance == pytest.approx(computed[rate].tolerance, nan_ok=True)


def test_another_experiment_or_fleet_has_another_digest():
    fleet = shipped_fleet(EXPERIMENTS / "pressing.toml")
    others = (
        shipped_fleet(EXPERIMENTS / "pressing.toml", ("plant.k_s_Nm_per_rad=1.01",)),
        shipped_fleet(EXPERIMENTS / "tapping.toml"),
        dataclasses.replace(fleet, seed=1),
    )
    assert len({fleet_digest(one) for one in (fleet, *others)}) == 4
    assert load_experiment(EXPERIMENTS / "pressing.toml").name == "pressing"


def test_tolerances_are_of_the_nearest_rate_and_of_none_that_is_far(tmp_path: Path):
    one = Tolerances(dict.fromkeys(CHANNELS, 1.0), dict.fromkeys(CHANNELS, float("nan")))
    other = Tolerances(dict.fromkeys(CHANNELS, 2.0), dict.fromkeys(CHANNELS, 0.5))
    write_tolerances(tmp_path / "a.json", "digest", {500.0: one, 250.0: other})
    assert read_tolerances(tmp_path / "a.json", "another") is None
    found = read_tolerances(tmp_path / "a.json", "digest")
    assert found is not None and tolerances_at(found, 253.0) == other and tolerances_at(found, 333.0) is None
