import hashlib
from dataclasses import asdict
from pathlib import Path

import pytest

from twin.cli.run_text import MAX_EVENTS, run_facts, run_text
from twin.robot.run.measures import ROWS_BY_KEY, missing_measures

NUMBERS = {
    "hold_error": 0.0939, "hold_overshoot": 0.0, "hold_settling_time": 0.852, "held_lateral_error": 0.00277,
    "hold_begin": 7.606, "hold_end": 20.0, "hold_overshoot_force": 0.0,
}  # fmt: skip
HELD = {key: {"value": NUMBERS.get(key), "reason": "" if key in NUMBERS else "below 0.05 N"} for key in ROWS_BY_KEY}
OUTCOME = {
    "measures": HELD, "peak": 4.961, "peak_time": 13.54, "end": 4.884, "end_x": -0.001, "end_y": -1.07,
    "force_error": 0.451, "lateral_error": 0.00218, "z_error": 0.00102,
}  # fmt: skip
RUN = {
    "experiment": "press", "simulated": 20.0, "stepping": 0.05, "writing": 0.2, "real_time_factor": 400.0,
    "remarks": ["2 of 2000 deadlines missed"], "outcome": OUTCOME, "trip": "", "changed": False, "punctuality": None,
    "substituted": {"controller": "Mine (PythonComponent)"},
    "held": (),
    "parts": {"monitor": "monitor: watch.fmu (sha256 0123456789ab); twin's own did not run"},
    "events": [(5.606, "INFO", "force control triggered at F_z = 0.603 N"), (6.0, "DEBUG", "for whoever looks closer")],
    "drives": ["a.fmu  FMI 2.0  sha256 0123\n  omega_ref <- w\n  warning: " + 12 * "so long " + "."] * 3,
    "recording": "results/press/2026/run.mcap",
}  # fmt: skip


def test_a_run_says_its_outcome_first_and_where_it_is_last():
    lines = run_text(RUN).splitlines()
    assert lines[:2] == ["press  20 s at 400 x real time", "  2 of 2000 deadlines missed"]
    assert lines[2:5] == [
        "  held       7.6 to 20.0 s: hold error 0.094 N, overshoot 0.0 %, settling time",
        "             0.85 s, chatter none (below 0.05 N)",
        "             lateral error while held 2.77 mm",
    ]
    assert lines[5] == "  force      at most 4.96 N, at 13.54 s, 4.88 N in the last second"
    assert lines[6] == "             0.00 N along x, -1.07 N along y in the last second"
    assert lines[7] == "             error since the first touch 0.45 N rms, force loop on"
    assert lines[8] == "  position   2.18 mm lateral and 1.02 mm in z from the reference, rms"
    assert lines[9] == "   5.606 s  force control triggered at F_z = 0.603 N"
    assert lines[-1] == "  recording  results/press/2026/run.mcap"
    assert max(map(len, lines)) <= 80


def test_a_force_that_is_held_more_than_once_says_how_often():
    held = OUTCOME | {"measures": HELD | {"holds": {"value": 3.0, "reason": ""}}}
    assert "  held       7.6 to 20.0 s in 3 parts: hold error" in run_text(RUN | {"outcome": held})


def test_a_large_overshoot_stands_in_the_first_line():
    large = {"hold_overshoot": {"value": 0.34, "reason": ""}, "hold_overshoot_force": {"value": 1.7, "reason": ""}}
    first = run_text(RUN | {"outcome": OUTCOME | {"measures": HELD | large}}).splitlines()[0]
    assert first == "press  20 s at 400 x real time  OVERSHOOT 34.0 %, 1.70 N"


def test_a_run_that_holds_nothing_says_why():
    none = {key: asdict(one) for key, one in missing_measures("no force loop").items()}
    run = RUN | {"outcome": OUTCOME | {"measures": none}}
    assert run_text(run).splitlines()[2] == "  held       none: no force loop"
    assert run_facts(run)["measures"]["hold_error"] == {"value": None, "unit": "N", "reason": "no force loop"}  # type: ignore[index]
    assert run_facts(run)["remarks"] == ["2 of 2000 deadlines missed"]


def test_tasks_say_what_was_held_instead_of_what_is_left_when_they_are_over():
    press = {
        "task": 1,
        "kind": "press",
        "force": 8.0,
        "taps": 0,
        "least": 7.9,
        "largest": 8.1,
        "begin": 4.4,
        "end": 9.4,
        "error": 0.009,
    }
    text = run_text(RUN | {"held": (press,)})
    assert (
        "  force      at most 4.96 N, at 13.54 s\n"
        "             7.90 to 8.10 N for 8.00 N, 4.4 to 9.4 s, error 0.009 N\n" in text
    )
    assert "last second" not in text
    tap = press | {"task": 2, "kind": "tap", "taps": 10, "error": None}
    text = run_text(RUN | {"held": (press | {"least": None}, tap, tap | {"least": None})})
    assert "             task 1: never held 8.00 N\n" in text
    assert "             task 2: 10 taps, peaks 7.90 to 8.10 N for 8.00 N, 4.4 to 9.4 s\n" in text
    assert "task 2: never tapped\n" in text and max(map(len, text.splitlines())) <= 80


def test_it_says_how_much_of_the_robot_is_assumed():
    counts = {"own": 2, "assumed": 16}
    lines = run_text(RUN | {"robot_values": counts}).splitlines()
    assert "  robot      2 own values, 16 inherited assumptions; twin accuracy ranks them" in lines
    assert max(map(len, lines)) <= 80 and run_facts(RUN | {"robot_values": counts})["robot_values"] == counts


def test_a_substitute_is_named():
    assert "  substitute controller: Mine (PythonComponent)\n" in run_text(RUN)


def test_a_part_of_another_make_is_named_and_twins_own_has_not_run():
    assert "  monitor    watch.fmu (sha256 0123456789ab); twin's own did not run\n" in run_text(RUN)
    text = run_text(RUN | {"outcome": OUTCOME | {"lateral_error": None, "z_error": None}})
    assert "the reference" not in text.partition("  position")[2]


def test_drives_that_are_the_same_are_told_once():
    assert run_text(RUN).count("a.fmu") == 1


def test_the_hash_of_a_drive_is_printed_unless_it_is_twins_own_unchanged(root: Path):
    digest = hashlib.sha256((root / "fmus/velocity_servo/velocity_servo.fmu").read_bytes()).hexdigest()[:12]
    own, changed = (f"velocity_servo.fmu  FMI 2.0  sha256 {one}" for one in (digest, "0123456789ab"))
    assert "  drive      velocity_servo.fmu  FMI 2.0\n" in run_text(RUN | {"drives": [own]})
    assert f"  drive      {changed}\n" in run_text(RUN | {"drives": [changed]})


def test_a_lateral_error_of_nothing_is_not_printed():
    text = run_text(RUN | {"outcome": OUTCOME | {"lateral_error": 4e-6}})
    assert "  position   1.02 mm in z from the reference, rms\n" in text


def test_a_run_that_never_touched_says_so():
    text = run_text(RUN | {"outcome": OUTCOME | {"peak": 0.0, "force_error": None}})
    assert "  force      none: it never touched\n" in text


@pytest.mark.parametrize("count", [MAX_EVENTS, MAX_EVENTS + 3])
def test_of_many_events_the_first_are_told_and_the_others_counted(count: int):
    text = run_text(RUN | {"events": [(0.001 * k, "WARNING", "the drive says the same again") for k in range(count)]})
    assert text.count("says the same") == MAX_EVENTS
    assert ("and 3 more events, in the recording" in text) == (count > MAX_EVENTS)


def test_for_programs_there_is_every_event():
    assert [event["t_s"] for event in run_facts(RUN)["events"]] == [5.606, 6.0]  # type: ignore[attr-defined]
