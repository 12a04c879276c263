import pytest

from twin.studies.check.text import MAX_SHOWN, check_result
from twin.studies.check.verdict import CheckRow, CheckVerdict

OK = CheckRow("z.rise_time", "s", 1.4, 1.41, 0.028, None, "ok")
WORSE = CheckRow("motors.commanded_travel", "rad", 0.4, 0.5, 0.008, None, "worse")
OUTSIDE = CheckRow("next_joint.tube", "rad", 0.14, float("nan"), 4e-4, 0.5, "outside")
LONG = CheckRow("force_on_the_left_shoulder.settling_time_2", "N", 5.0, 6.0, 0.1, None, "worse")
NEW = CheckRow("z.rise_time", "s", None, 1.4, None, None, "new")


def verdict(*rows: CheckRow, drive: str = "torque_motor_fmi3", notes: tuple[str, ...] = ()) -> CheckVerdict:
    return CheckVerdict("step_force_scale", drive, rows, notes)


def test_many_checks_that_are_as_they_were_are_one_line():
    assert check_result([verdict(OK), verdict(OK, drive="b")], []).text == (
        "All as it was: 1 experiment, 2 drives, 2 numbers and curves"
    )


def test_a_single_check_shows_every_number():
    assert (
        "  ok      z.rise_time s            1.4      1.41     0.028"
        in check_result([verdict(OK)], []).text.splitlines()
    )


def test_of_many_checks_only_what_deviates_is_shown_in_units_people_read():
    lines = check_result([verdict(OK, WORSE, OUTSIDE), verdict(OK, drive="b")], []).text.splitlines()
    assert lines[0] == "1 of 2 checks deviates: 1 worse, 1 outside"
    assert not any("rise_time" in line for line in lines)
    assert "  worse   motors.commanded_travel  deg        22.92     28.65    0.4584" in lines
    # what is not a number is not shown as one
    assert "  outside next_joint.tube at 0.5 s deg        8.021         -   0.02292" in lines
    assert "  and 1 as they were" in lines


def test_beyond_a_few_checks_are_told_by_what_they_come_to():
    lines = check_result([verdict(WORSE, drive=f"d{k}") for k in range(MAX_SHOWN + 1)], []).text.splitlines()
    assert lines[-1] == f"step_force_scale, d{MAX_SHOWN}: 1 worse"


def test_first_baselines_are_counted_only():
    assert check_result([verdict(NEW), verdict(NEW, drive="b")], []).text == (
        "New: 1 experiment, 2 drives, 2 numbers and curves"
    )


def test_a_note_that_many_share_is_told_once():
    text = check_result([verdict(OK, drive=name, notes=("x.fmu has changed",)) for name in "ab"], []).text
    assert text.count("x.fmu has changed (2 checks)") == 1


def test_what_could_not_be_done_is_told_first_and_in_full():
    text = check_result([verdict(OK)], ["a.toml: a long sentence " + 12 * "of many words "]).text
    assert text.splitlines()[1] == "  1 check could not be done"
    assert "  not done a.toml: a long sentence" in text
    assert check_result([], ["x"]).text.startswith("1 check could not be done")


@pytest.mark.parametrize("rows", [(OK,), (WORSE, OUTSIDE), (NEW,), (OK, LONG)])
def test_no_line_is_longer_than_a_terminal(rows: tuple[CheckRow, ...]):
    text = check_result([verdict(*rows, notes=("a note " * 20,)), verdict(OK)], ["a sentence " * 20]).text
    assert max(len(line) for line in text.splitlines()) <= 80
