"""The answer to "Which spring?", computed from recordings with none of twin's measures."""

from pathlib import Path

import numpy as np
import pytest

from tests.studies.sweep.statistics.rows import kept, row
from twin.kernel.process.job import JobLimits
from twin.kernel.recording.reader import read
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute
from twin.studies.sweep.columns import Row
from twin.studies.sweep.engine import LocalEngine
from twin.studies.sweep.margins import trial as margins_of
from twin.studies.sweep.plan import plan_of, short_definition
from twin.studies.sweep.show.parts import headline
from twin.studies.sweep.statistics.ranking import equal_to_best, ranked_rows, usual_metric, value
from twin.studies.sweep.stored import stored_sweep
from twin.studies.sweep.study import complete_sweep
from twin.studies.sweep.worker import trial

SPRINGS = (0.2, 0.3, 0.5, 0.8, 0.9, 1.5, 3.0)
"""Of the 29 of README's command (N m/rad): both ends, the best, the last that equals it, the next, the old answer."""


def by_hand(folder: Path) -> tuple[float, float | None, float]:
    """(rms of F - R (N), settling time (s), overshoot (%)) of a recorded run of Fig. 4."""
    run = read(folder)
    t, F = run.time("plant"), -run["plant.F_ee_B"][:, 2]
    place = np.searchsorted(run.time("controller"), t + 1e-9, side="right") - 1
    on, R = (np.asarray(run[key])[place.clip(0)] for key in ("controller.triggered", "controller.F_z_ref"))
    first = int(np.argmax((np.cumsum(F > 0.0) > 0) & (on > 0)))
    held = t >= t[first] + 2.0 - 1e-9
    error = F - R
    outside = np.flatnonzero(np.abs(error) > 0.05 * R)[-1]
    settling = None if outside == len(t) - 1 else float(t[outside + 1] - t[first])
    return (
        float(np.sqrt(np.mean(error[held & (on > 0)] ** 2))),
        settling,
        100.0 * max(0.0, float(error[(t >= t[first]) & (t < t[first] + 2.0 - 1e-9)].max())) / 5.0,
    )


@pytest.fixture(scope="module")
def rows(root: Path) -> list[Row]:
    path = root / "experiments/fig4_force_position.toml"
    findings = {k: trial(path, None, [f"robot.k_s_Nm_per_rad={k}"]) for k in SPRINGS}
    return [
        row(n, {"robot.k_s": k}, None, "done", **one["metrics"]) for n, (k, one) in enumerate(findings.items(), start=1)
    ]


def test_the_ranking_of_springs_is_that_of_the_recorded_forces(root: Path, rows: list[Row], tmp_path: Path):
    found: dict[float, float] = {}
    for k, one in zip(SPRINGS, rows, strict=True):
        experiment = load_experiment(root / "experiments/fig4_force_position.toml", [f"robot.k_s_Nm_per_rad={k}"])
        execute(experiment, tmp_path / str(k))
        found[k], settling, overshoot = by_hand(tmp_path / str(k))
        metrics = one["metrics"]
        assert metrics["hold_error_N"] == pytest.approx(found[k], abs=1e-12)
        assert metrics["hold_settling_time_s"] == (settling and pytest.approx(settling, abs=1e-9))
        assert metrics["hold_overshoot_percent"] == pytest.approx(overshoot, abs=1e-9)
    sweep = kept(rows)
    by = usual_metric(sweep.columns)
    ranked = [SPRINGS[row] for row in ranked_rows(sweep.columns, by)]
    assert ranked == sorted(SPRINGS, key=found.__getitem__) and ranked[0] == 0.5
    assert (round(found[0.5], 3), round(found[1.5], 3)) == (0.031, 0.153)
    equal = [SPRINGS[row] for row in equal_to_best(sweep.columns, by)]
    assert equal == [0.8, 0.3] == sorted(equal, reverse=True) and found[0.9] > found[0.5] + 0.05 > found[0.8]
    assert "edge" not in headline(sweep, by)


def test_the_error_since_the_first_touch_would_choose_another_spring(rows: list[Row]):
    sweep = kept(rows)
    assert SPRINGS[ranked_rows(sweep.columns, "force_error_N")[0]] == 1.5
    # which is why rows without a hold error say what they are ranked by
    assert value(sweep.columns, "hold_error_N")[SPRINGS.index(1.5)] > 0.15


@pytest.mark.slow
def test_margins_are_computed_once_at_the_end_and_kept_beside_the_rows(root: Path, tmp_path: Path):
    original = root / "experiments/fig4_force_position.toml"
    plan = plan_of(short_definition(original, ["robot.k_s_Nm_per_rad=0.5:1:2"], None), original, "mine", "--sweep")
    said: list[str] = []
    for _ in range(2):
        complete_sweep(plan, tmp_path / "s", LocalEngine(1), JobLimits(), lambda text, *_: said.append(text))
    found = [*stored_sweep(tmp_path / "s").margins.values()]
    assert [(one["run"], one["reason"]) for one in found] == [(1, ""), (2, "")]
    assert [round(one["gain"] or 0.0) for one in found] == [129, 97]
    assert [round(np.degrees(one["phase_rad"] or 0.0)) for one in found] == [108, 109]
    assert said.count("margins of the best runs") == 1


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (["controller.force.kp_mm_per_N=1e3"], "unstable"),
        (['controller.mode="position"'], "no force loop in contact"),
        (["robot.k_s_Nm_per_rad=-1"], "k_s"),
    ],
)
def test_a_run_without_margins_has_the_reason(root: Path, settings: list[str], reason: str):
    found = margins_of(root / "experiments/fig4_force_position.toml", None, settings)
    assert found["status"] == "failed" and reason in found["reason"] and "\n" not in found["reason"]
