"""The paper's experiment with several drives; for velocity_servo against an independent computation of Fig. 4."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.kernel.fmi.faulty import faulty_drive
from tests.robot.run.made_up import made_up
from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.program import PhaseKind
from twin.robot.experiment.experiment import Experiment
from twin.robot.run import runs
from twin.robot.run.measures import ROWS_BY_KEY
from twin.robot.run.trace import run_in_memory
from twin.studies.qualify.comparison import (
    COMPARED_MEASURES,
    ComparedDrive,
    DriveTrials,
    TrueRun,
    comparison_facts,
    disturb_encoders,
    trials,
    verdict,
)
from twin.studies.qualify.text import compare_blocks
from twin.studies.result import lay_out

FIG4 = ROOT / "experiments/fig4_force_position.toml"
PRESSING = ROOT / "experiments/pressing.toml"


@pytest.fixture(scope="module")
def fig4() -> tuple[ComparedDrive, ...]:
    (done,) = trials([FIG4], ["velocity_servo", "pmsm_foc", "brushed_dc"])
    return done.trials


def values(trial: ComparedDrive) -> dict[str, float | None]:
    return {measure.name: measure.value for measure in trial.measures}


def test_the_robot_behaves_as_the_reference_computation_of_fig4(fig4: tuple[ComparedDrive, ...]):
    servo = values(fig4[0])
    # triggered at 5.61 s, the true force settles at 6.46 s, each to 0.01 s
    assert servo["settling_time"] == pytest.approx(0.85, abs=0.02)
    assert servo["overshoot"] == 0.0
    # that computation looks at 10.7 to 18.7 s, this one at 10 to 20 s: 10 %
    assert servo["rms_force_error"] == pytest.approx(0.09, rel=0.1)
    assert servo["rms_z_error"] == pytest.approx(0.07e-3, rel=0.1)


def test_what_a_drive_does_not_tell_is_a_gap_with_a_reason(fig4: tuple[ComparedDrive, ...]):
    servo, machine, brushed = map(values, fig4)
    assert servo["peak_current"] is None and machine["energy"] is None
    assert machine["peak_current"] is not None and 0.0 < machine["peak_current"] < 5.7
    assert brushed["energy"] is not None and brushed["shaft_work"] is not None
    # electrical energy is work and losses
    assert brushed["energy"] > brushed["shaft_work"] > 0.0


def test_the_table_fits_80_columns_with_one_line_per_drive(fig4: tuple[ComparedDrive, ...]):
    lines = lay_out(compare_blocks(DriveTrials("fig4", fig4))).splitlines()
    assert max(map(len, lines)) <= 80
    assert [line.split()[0] for line in lines[2:5]] == ["velocity_servo", "pmsm_foc", "brushed_dc"]
    head = " ".join(lines[0].split())
    assert head == "hold over settle lateral z peak I work energy cost"
    # the numbers of the table of measures, not those of 1.0
    servo = fig4[0].done.measures
    assert lines[2].split()[1:4] == ["0.0939", "0", f"{servo['hold_settling_time'].value:.3g}"]


def test_the_verdict_names_every_measure_that_both_have_and_not_what_the_model_costs(fig4: tuple[ComparedDrive, ...]):
    (said, other) = verdict([DriveTrials("fig4", fig4)])
    assert said.startswith("pmsm_foc beside velocity_servo: ") and other.startswith(
        "brushed_dc beside velocity_servo: "
    )
    assert all(name in said for name in ("hold error", "overshoot", "settling time", "chatter", "lateral", "work"))
    assert not any(name in said for name in ("current", "energy", "cost"))


def test_the_verdict_has_the_interval_of_a_difference_in_one_experiment(fig4: tuple[ComparedDrive, ...]):
    one = DriveTrials("fig4", fig4)
    (overshoot,) = (d for d in one.differences()["pmsm_foc"] if d.measure.key == "hold_overshoot")
    assert overshoot.rank == 1 and f"overshoot ({overshoot.text})" in verdict([one])[0]
    assert " +- " not in verdict([one, one])[0]


def held_rms(experiment: Experiment) -> float:
    """Root mean square of F - R over the ticks in which a task holds, of a run, with numpy alone."""
    run = run_in_memory(experiment)
    held = np.isin(run.held("controller.phase"), (PhaseKind.HOLD, PhaseKind.CIRCLE, PhaseKind.PUSH))
    e = -run["plant.F_ee_B"][held, 2] - run.held("controller.F_z_ref")[held]
    return float(np.sqrt(np.mean(e * e)))


@pytest.mark.slow
def test_eight_paired_runs_on_pressing_find_two_drives_the_same_and_one_worse():
    drives = ["velocity_servo", "pmsm_foc", "mx106", "xl330"]
    (done,) = trials([PRESSING], drives)
    found = {name: ds[0] for name, ds in done.differences().items()}
    assert {name: one.verdict for name, one in found.items()} == {"pmsm_foc": "same", "mx106": "same", "xl330": "worse"}
    # computed from the traces of the same runs
    by_hand = {
        drive: np.array(
            [held_rms(disturb_encoders(load_experiment(PRESSING, (), drive), seed)) for seed in range(1, 9)]
        )
        for drive in drives
    }
    for name, one in found.items():
        d = by_hand[name] - by_hand["velocity_servo"]
        assert one.measure.key == "hold_error"
        assert one.mean == pytest.approx(d.mean(), rel=1e-9)
        assert one.half_width == pytest.approx(2.365 * d.std(ddof=1) / 8**0.5, rel=1e-9)
        assert one.agreeing == np.sum(np.sign(d) == np.sign(d.mean()))
    # other draws gave 0.0000 +- 0.0008, 0.016 +- 0.008 and 0.42 +- 0.03 N
    assert found["pmsm_foc"].mean == pytest.approx(0.0, abs=8e-4)
    assert found["mx106"].mean == pytest.approx(0.016, abs=0.008)
    assert found["xl330"].mean == pytest.approx(0.42, abs=0.03)


def test_every_drive_has_the_same_draws_and_the_file_keeps_its_own_noise():
    own = ["plant.motor_noise_deg=0.3", "plant.joint_zero_deg=[1,2,3]"]
    servo, foc = (load_experiment(PRESSING, own, drive) for drive in ("velocity_servo", "pmsm_foc"))
    one, other = (disturb_encoders(experiment, 3).plant for experiment in (servo, foc))
    assert (one.motor_zero, one.joint_zero) == (other.motor_zero, other.joint_zero)
    assert np.degrees(one.motor_noise) == pytest.approx(0.3) and np.degrees(one.joint_noise) == pytest.approx(0.02)
    off = np.degrees(one.joint_zero) - [1.0, 2.0, 3.0]
    assert np.all(np.abs(off) <= 0.022) and np.any(off)
    assert disturb_encoders(servo, 4).plant.motor_zero != one.motor_zero and disturb_encoders(servo, 3).seed == 3


def test_a_drive_that_trips_in_a_paired_run_is_not_judged(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(runs, "trip_reason", lambda simulation: "FORCE")
    (done,) = trials([PRESSING], ["velocity_servo", "pmsm_foc"])
    assert not done.differences()
    said = "pmsm_foc trips the safety monitor in pressing with seed 1, and is not judged there (FORCE)"
    assert said in verdict([done])


def test_facts_name_every_measure_of_every_drive(fig4: tuple[ComparedDrive, ...]):
    facts = comparison_facts(DriveTrials("fig4", fig4))
    assert [drive["drive"] for drive in facts["drives"]] == ["velocity_servo", "pmsm_foc", "brushed_dc"]
    assert all(list(drive["measures"]) == list(COMPARED_MEASURES) for drive in facts["drives"])
    assert all(list(drive["run_measures"]) == list(ROWS_BY_KEY) for drive in facts["drives"])
    assert facts["drives"][1]["run_measures"]["current"]["value"] == values(fig4[1])["peak_current"]


def test_a_drive_that_fails_keeps_its_place_and_the_others_run(tmp_path: Path):
    folder = tmp_path / "faulty"
    folder.mkdir()
    faulty_drive(ROOT, folder)
    (folder / "mapping.toml").write_text('fmu = "faulty.fmu"\n[parameters]\ndroop = 2.0\n')
    (done,) = trials([FIG4], [str(folder), "velocity_servo"])
    failed, servo = done.trials
    assert "NaN" in failed.failure and all(measure.value is None for measure in failed.measures)
    assert servo.failure == ""
    assert "FAILED" in lay_out(compare_blocks(done))
    assert verdict([done]) == [f"{folder} failed in fig4_force_position, and is not judged there"]


def test_nothing_runs_if_one_drive_is_refused():
    with pytest.raises(InputRefused, match="no such drive"):
        trials([FIG4], ["velocity_servo", "nowhere"])


def measured(rows: int, **signals: Any) -> dict[str, float | None]:
    """Measures of a made-up run of `rows` ticks without contact; `signals` by port, 0 where nothing is said."""
    owners = {
        "plant": {"p_B": 3, "F_ee_B": 3, "tau_load": 3},
        "controller": {"p_ref_B": 3, "triggered": 1, "F_z_ref": 1},
        "drive": {"omega_m": 3} | ({"current": 3, "power": 3} if "power" in signals else {}),
    }
    run = made_up(
        {
            f"{owner}.{port}": np.zeros((rows, size)) + signals.get(port, 0.0)
            for owner, ports in owners.items()
            for port, size in ports.items()
        }
    )
    return {measure.name: measure.value for measure in TrueRun(run).measures(0.0)}


def position_run(z: np.ndarray, z_ref: np.ndarray) -> dict[str, float | None]:
    """Measures of a made-up run of heights alone."""
    return measured(len(z), p_B=z[:, None] * [0.0, 0.0, 1.0], p_ref_B=z_ref[:, None] * [0.0, 0.0, 1.0])


def test_work_and_energy_are_power_times_time():
    found = measured(
        2001,
        tau_load=[0.5, 0.5, -0.2],
        omega_m=[2.0, -1.0, -3.0],
        current=[1.0, -4.0, 2.0],
        power=[1.5, -0.25, 1.0],
    )
    # over 2 s: 1 W and 0.6 W of two shafts that drive, the one that is driven left out; all three are fed
    assert found["shaft_work"] == pytest.approx(3.2, rel=1e-12)
    assert found["energy"] == pytest.approx(4.5, rel=1e-12)
    assert found["peak_current"] == 4.0


def test_the_numbers_of_1_0_go_on_after_a_trip_and_the_measures_of_the_run_do_not():
    fault = '[{kind="sample_loss",onset_s=6.5,duration_s=0.02,magnitude_share=1.0}]'
    (done,) = trials([PRESSING], ["pmsm_foc"], [f"fault={fault}"])
    (foc,) = done.trials
    run = foc.run.run
    power, current = run["plant.tau_load"] * run.of_drives("omega_m"), np.abs(run.of_drives("current"))
    end = int(np.flatnonzero(run.held("monitor.reason"))[0])
    assert 0 < end < len(power)
    for rows, work, largest in (
        (slice(None), values(foc)["shaft_work"], values(foc)["peak_current"]),
        (slice(end), foc.done.measures["shaft_work"].value, foc.done.measures["current"].value),
    ):
        assert work == pytest.approx(1e-3 * np.sum(power[rows][:-1].clip(min=0.0)), rel=1e-12)
        assert largest == current[rows].max()
    assert values(foc)["shaft_work"] != foc.done.measures["shaft_work"].value


def test_without_force_control_the_height_is_what_settles_and_overshoots():
    t = 1e-3 * np.arange(4000)
    z_ref = np.where(t < 1.0, -0.085, -0.090)
    z = -0.085 - 0.005 * np.where(t < 1.0, 0.0, 1.0 - np.exp(-(t - 1.0) / 0.2))
    lag = position_run(z, z_ref)
    # 5 % of an exponential are left after 3 time constants; a tick at either end
    assert lag["settling_time"] == pytest.approx(0.2 * np.log(20.0), abs=2e-3)
    assert lag["overshoot"] == 0.0
    z[2000:2100] = -0.0905
    # 0.5 mm of 5 mm; rounding
    assert position_run(z, z_ref)["overshoot"] == pytest.approx(10.0, rel=1e-9)


def test_only_the_last_change_of_the_reference_counts():
    t = 1e-3 * np.arange(4000)
    z_ref = np.select([t < 1.0, t < 2.0, t < 3.0], [-0.085, -0.095, -0.105], -0.104)
    assert position_run(z_ref + 0.0001, z_ref)["overshoot"] == pytest.approx(10.0, rel=1e-6)
    assert position_run(z_ref, np.full(4000, -0.1))["settling_time"] is None


def test_drives_are_compared_in_a_task_by_the_force_that_it_holds():
    (servo,) = trials([ROOT / "experiments/pressing.toml"], ["velocity_servo"])[0].trials
    measured = {measure.name: measure for measure in servo.measures}
    assert measured["settling_time"].remark == "not defined for tasks"
    # docs/tasks.md: 8 N are held to 0.01 N, with no more above it than the estimate rounds by
    assert measured["rms_force_error"].value == pytest.approx(0.009, abs=0.002)
    assert 0.0 < (measured["overshoot"].value or 0.0) < 1.0


def test_taps_hold_no_force_to_be_compared():
    (servo,) = trials([ROOT / "experiments/tapping.toml"], ["velocity_servo"])[0].trials
    measured = {measure.name: measure for measure in servo.measures}
    assert measured["rms_force_error"].value is None
    assert measured["rms_force_error"].remark == "no task holds a force"
    assert measured["overshoot"].remark == "the force loop is never on"
