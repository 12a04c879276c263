from pathlib import Path

import pytest

from twin.recording.logs.column_map import unit
from twin.studies.compare.tolerance import Allowance, ComparisonRefused, allowance, matches, rules

N, M = unit("N", ""), unit("m", "")


def allowed(signal: str, *texts: str, of=N, span: float = 10.0) -> Allowance:
    return allowance(signal, of, span, 0.0, rules(texts))


def test_without_rules_two_percent_of_the_range_and_two_controller_periods_are_allowed():
    assert allowed("controller.F_z") == Allowance(0.2, 0.004)


def test_numbers_of_ten_digits_are_equal_to_those_they_were():
    assert allowance("F", N, 0.0, 5.0, ()).value == 5e-9


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["1%"], Allowance(0.1, 0.004)),
        (["1 % @ 10 ms"], Allowance(0.1, 0.01)),
        (["@0s"], Allowance(0.2, 0.0)),
        (["controller.F_z=50mN"], Allowance(0.05, 0.004)),
        (["controller.*=0.05 N @ 1 ms"], Allowance(0.05, 0.001)),
        (["1%", "controller.F_z=0.05N"], Allowance(0.05, 0.004)),
        (["controller.F_z=0.05N", "1%"], Allowance(0.1, 0.004)),
        (["plant.*=1N"], Allowance(0.2, 0.004)),
        (["*=1mm@1ms"], Allowance(0.2, 0.001)),
    ],
)
def test_the_last_rule_that_says_something_wins(texts: list[str], expected: Allowance):
    assert allowed("controller.F_z", *texts) == expected


def test_file_and_command_line_say_the_same(tmp_path: Path):
    file = tmp_path / "tol.toml"
    file.write_text('"*" = "1 % @ 10 ms"\ncontroller.F_z = "0.05 N"\n"plant.p_B[2]" = "0.1 mm"\n')
    texts = ["*=1%@10ms", "controller.F_z=0.05N", "plant.p_B[2]=0.1mm"]
    assert rules([str(file)]) == rules(texts)


@pytest.mark.parametrize(
    ("pattern", "signal", "fits"),
    [
        ("plant.p_B", "plant.p_B[2]", True),
        ("plant.p_B[2]", "plant.p_B[2]", True),
        ("plant.p_B[1]", "plant.p_B[2]", False),
        ("*.F_z", "controller.F_z", True),
        ("drive/?.omega_m", "drive/2.omega_m", True),
        ("controller.F", "controller.F_z", False),
    ],
)
def test_a_pattern_fits_components_and_brackets_are_indices(pattern: str, signal: str, fits: bool):
    assert matches(pattern, signal) is fits


@pytest.mark.parametrize("text", ["", "F=", "F=x", "F=-1N", "F=1Nx", "F=1N@1N", "F=1N@", "F=1e999N", "=1N"])
def test_what_is_no_rule_is_refused(text: str):
    with pytest.raises(ComparisonRefused, match="--tol"):
        rules([text])


def test_every_mistake_of_a_file_is_told_with_its_place(tmp_path: Path):
    file = tmp_path / "tol.toml"
    file.write_text('F = "x"\nG = 3\n')
    with pytest.raises(ComparisonRefused) as refused:
        rules([file, "nowhere.toml"])
    assert [line.partition(":")[0] for line in str(refused.value).splitlines()] == [
        str(file),
        str(file),
        "--tol nowhere.toml",
    ]


def test_a_tolerance_of_another_dimension_is_refused_where_the_signal_is_named():
    with pytest.raises(ComparisonRefused, match=r"tolerance of controller\.F_z is in m, but it is in N"):
        allowed("controller.F_z", "controller.F_z=1mm")
