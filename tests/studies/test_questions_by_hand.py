"""README's questions on drives, gains, logs, faults, accuracy: the answers, computed again by numpy from recordings."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.command_line import twin
from tests.robot.run import by_hand as hand
from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.load import load_experiment
from twin.robot.monitor.reasons import Reason
from twin.robot.run.run import execute
from twin.studies.qualify.comparison import disturb_encoders

FIG4 = "fig4_force_position"


def answer(*command: str, folder: Path) -> dict[str, Any]:
    """The JSON that a command of README prints."""
    done = twin(*command, "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def recorded(folder: Path, experiment: str, out: str, *settings: str) -> Recording:
    """The recording of a run of its own."""
    words = [word for setting in settings for word in ("--set", setting)]
    answer("run", experiment, "--out", out, *words, folder=folder)
    return read(folder / out / "run.mcap")


def last_at(times: NDArray[Any], t: NDArray[Any]) -> NDArray[np.intp]:
    """Index of the last sample at or before each of `t`."""
    return np.searchsorted(times, t + 5e-10, side="right") - 1


def moments(e: NDArray[np.float64]) -> dict[str, float]:
    return {"bias": float(e.mean()), "std": float(e.std()), "rms": float(np.sqrt(np.mean(e**2)))}


LEAST = {"hold_error": 0.05, "hold_overshoot": 0.01, "chatter": 0.05, "held_lateral_error": 2.5e-5,
         "held_z_error": 2.5e-5}  # fmt: skip
"""Smallest difference that counts, SI; of torque and work 5 %."""
NAMES = {
    "hold_error": "hold error", "hold_overshoot": "overshoot", "chatter": "chatter",
    "held_lateral_error": "lateral error while held", "held_z_error": "z error while held",
    "torque": "largest torque", "shaft_work": "shaft work",
}  # fmt: skip


def judged_by_hand(run: Recording) -> dict[str, float]:
    """What drives are judged by, SI."""
    found = hand.measures(run) | hand.efforts(run)
    # a swing too small to be reported is none
    return {key: found[key] if key != "chatter" or found[key] >= 0.05 else 0.0 for key in NAMES}


@pytest.mark.slow
def test_the_verdict_on_two_drives_is_that_of_eight_pairs_of_recordings(root: Path, tmp_path: Path):
    drives = ("velocity_servo", "pmsm_foc")
    found = answer("drive", "compare", *drives, "--experiment", "pressing", folder=tmp_path)
    (experiment,) = found["experiments"]
    table: dict[str, list[NDArray[Any]]] = {}
    for drive, said in zip(drives, experiment["drives"], strict=True):
        one = load_experiment(root / "experiments/pressing.toml", (), drive)
        itself = judged_by_hand(read(execute(one, tmp_path / drive).recording))
        for key, value in itself.items():
            own = said["run_measures"][key]["value"]
            assert (own or 0.0) == pytest.approx(value, rel=1e-9, abs=1e-12), (drive, key)
        pairs = [
            judged_by_hand(read(execute(disturb_encoders(one, seed), tmp_path / f"{drive}_{seed}").recording))
            for seed in range(1, 9)
        ]
        for key in NAMES:
            table.setdefault(key, []).append(np.array([pair[key] for pair in pairs]))
    said, verdicts = experiment["paired"]["drives"]["pmsm_foc"], {}
    assert set(said) == set(NAMES)
    for key, (first, other) in table.items():
        d = other - first
        mean, half_width = d.mean(), 2.365 * d.std(ddof=1) / np.sqrt(8.0)
        least = LEAST.get(key, 0.05 * max(first.mean(), other.mean()))
        verdicts[key] = "same" if abs(mean) <= max(half_width, least) else "better" if mean < 0.0 else "worse"
        assert said[key]["mean"] == pytest.approx(mean, rel=1e-7, abs=1e-12), key
        assert said[key]["half_width"] == pytest.approx(half_width, rel=1e-7, abs=1e-12), key
        assert said[key]["agreeing"] == np.sum(d * mean > 0.0) and said[key]["runs"] == 8
        assert said[key]["verdict"] == verdicts[key], key
    z = table["held_z_error"][1] - table["held_z_error"][0]
    interval = (
        f"{1e3 * z.mean():+.4f} +- {1e3 * 2.365 * z.std(ddof=1) / np.sqrt(8.0):.4f} mm, in {np.sum(z < 0.0)} of 8"
    )
    same = ", ".join(name for key, name in NAMES.items() if verdicts[key] == "same")
    assert [key for key, one in verdicts.items() if one != "same"] == ["held_z_error"]
    sentence = f"pmsm_foc beside velocity_servo: better in z error while held ({interval}); the same in {same}"
    assert found["verdict"] == [sentence]


@pytest.mark.slow
def test_the_gains_before_and_after_tuning_are_judged_as_their_recordings_are(tmp_path: Path):
    found = answer("tune", FIG4, "--stiffness-N-per-m", "300:5000", folder=tmp_path)
    keys = ("hold_error", "hold_overshoot", "hold_settling_time", "held_lateral_error", "held_z_error")
    tuned = found["again"].removeprefix("twin run ")
    for side, experiment in (("before", FIG4), ("after", tuned)):
        itself = hand.measures(recorded(tmp_path, experiment, side))
        (run,) = found[side]["runs"]
        for key in keys:
            assert run["measures"][key]["value"] == pytest.approx(itself[key], rel=1e-9, abs=1e-12), (side, key)


def test_what_a_replay_says_of_the_force_is_in_the_run_that_it_takes_for_a_log(tmp_path: Path):
    run = recorded(tmp_path, FIG4, "run")
    found = answer("replay", "run", "--plant", folder=tmp_path)
    t, measured = run.time("scale"), run["scale.F_z"]
    # the same estimator reads the same counts; the plant model starts at rest where the log does
    estimate = -run["estimator.F_ee_B"][last_at(run.time("estimator"), t), 2]
    true = -run["plant.F_ee_B"][last_at(run.time("plant"), t), 2]
    forces, e = found["force_N"], estimate - measured
    worst = int(np.argmax(np.abs(e)))
    by_hand = moments(e) | {"largest": e[worst], "at": t[worst]}
    assert {key: forces["estimator"][key] for key in by_hand} == pytest.approx(by_hand, rel=1e-9)
    # the model is driven by the angles of the log, which are counts
    by_hand = moments(true - measured)
    assert {key: forces["plant"][key] for key in by_hand} == pytest.approx(by_hand, abs=0.02)
    assert found["verdict"] == "matches" and found["samples"] == len(run.time("encoder"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["surface_jump", "spring_broken", "drive_dead"])
def test_a_row_of_the_fault_matrix_is_a_run_with_that_fault(tmp_path: Path, kind: str):
    found = answer("faults", "pressing", "--kind", kind, folder=tmp_path)
    for number, row in enumerate(found["rows"]):
        onset = row["onset_s"]
        size = "".join(f", {key}={row[key]}" for key in row if key.startswith("magnitude") and row[key] is not None)
        fault = f'fault=[{{kind="{kind}", onset_s={onset}{size}}}]'
        for watched, said in ((True, row["with_monitor"]), (False, row["without_monitor"])):
            settings = [fault, *(["monitor.enabled=false"] if not watched else [])]
            words = [word for setting in settings for word in ("--set", setting)]
            out = f"{number}{watched}"
            # a trip that a fault explains is no failure
            assert twin("run", "pressing", "--out", out, *words, cwd=tmp_path).returncode == 0
            run = read(tmp_path / out / "run.mcap")
            t, force = run.time("plant"), np.linalg.norm(run["plant.F_ee_B"], axis=1)
            after = t >= onset - 5e-10
            peak = force[after].max()
            assert said["peak_N"] == pytest.approx(peak, rel=1e-12)
            assert said["peak_delay_s"] == pytest.approx(t[after][force[after].argmax()] - onset, abs=1e-9)
            assert said["above_s"] == pytest.approx(1e-3 * np.sum(force[after] > row["limit_N"]), abs=1e-9)
            if watched:
                trips = np.flatnonzero(run["monitor.reason"])
                assert bool(said["reason"]) == bool(len(trips))
                if len(trips):
                    assert said["reason"] == Reason(int(run["monitor.reason"][trips[0]])).name
                    assert said["delay_s"] == pytest.approx(run.time("monitor")[trips[0]] - onset, abs=1e-9)


EXACT = tuple(f"robot.{encoder}_counts_per_turn=1099511627776" for encoder in ("motor", "joint"))
IDEAL = (*EXACT, "robot.backlash_deg=0", "controller.dead_zone_deg=0", "cosim.tick_ms=0.125", "cosim.inputs=linear")


@pytest.mark.slow
def test_a_line_of_the_accuracy_budget_is_the_difference_of_two_recordings(tmp_path: Path):
    found = answer("accuracy", FIG4, folder=tmp_path)
    lines = {one["label"]: one for one in found["contributions"]}

    def error(out: str, *settings: str) -> NDArray[np.float64]:
        run = recorded(tmp_path, FIG4, out, *settings)
        t = run.time("estimator")
        off = run["plant.F_ee_B"][last_at(run.time("plant"), t), 2] - run["estimator.F_ee_B"][:, 2]
        return off[(t >= found["start_s"] - 5e-10) & (t <= found["end_s"] + 5e-10)]

    ideal = error("ideal", *IDEAL)
    by_hand = {
        "as it is": error("as_is"),
        "statics only": ideal,
        "k_s +2 %": error("k_s", *IDEAL, "controller.model.k_s_Nm_per_rad=1.02") - ideal,
        "masses +5 %": error(
            "masses", *IDEAL, *(f"controller.model.{m}" for m in ("m_a_g=42", "m_b_g=31.5", "m_p_g=105"))
        )
        - ideal,
    }
    for label, e in by_hand.items():
        said = {key: lines[label][f"{key}_N"] for key in ("bias", "std", "rms")}
        assert said == pytest.approx(moments(e), rel=1e-6, abs=1e-9), label
