import pytest

from tests.bytes.normal import normal, normal_error


@pytest.mark.parametrize(
    "text, expected",
    [
        ("results/fig4/2026-11-24_001152/run.mcap", "results/fig4/TIME/run.mcap"),
        ("fig4  20 s at 1.27e+03 x real time", "fig4  20 s at N x real time"),
        ('{"stepping_s": 0.17, "peak_N": 4.93}', '{"stepping_s": N, "peak_N": 4.93}'),
        ('"microseconds": {\n  "plant": 0.4\n}, "trip": ""', '"microseconds": {N}, "trip": ""'),
        ("plant.fmu  sha256 2ad5908fcb7e  0.59 us\n", "plant.fmu  sha256 HASH  N us\n"),
        (r'"{\"sha256\": \"' + 64 * "a" + r'\"}"', r'"{\"sha256\": \"HASH\"}"'),
        ('sha256 = "' + 64 * "a" + '"', 'sha256 = "HASH"'),
        ("velocity_servo   - 0.561  0.126\n", "velocity_servo   - 0.561 N\n"),
        ("compiling, once: 3 of about 13, 9 s\n5 N", "5 N"),
    ],
)
def test_moments_and_durations_are_replaced_and_nothing_else(text: str, expected: str) -> None:
    assert normal(text) == expected


@pytest.mark.parametrize(
    "text", ["4.96 N at 13.54 s at most", '"force_error_N": 0.45', "1e-3 s", "| stepper | 1.0 | 2 |x"]
)
def test_results_stay_as_they_are(text: str) -> None:
    assert normal(text) == text


def test_lines_that_say_how_far_it_is_are_left_out_of_what_goes_to_the_error_stream() -> None:
    assert normal_error("broken  0.1 / 13.0 s, 412 x real time\nstep_z_air 3 of 8 checks\nrefused\n") == "refused\n"
