"""Disk margins and step metrics beside python-control's."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.yardstick import Yardstick

Complex = NDArray[np.complex128]

PRINTED_LAG = {"disk margin": (0.46, 0.01), "gain (dB)": (4.05, 0.01), "phase (degrees)": (25.8, 0.1)}
"""control/tests/margin_test.py, test_siso_disk_margin: "disk margin of 0.46", "disk-based gain margin of 4.05 dB",
"disk-based phase margin of 25.8 deg" of tf(25, [1, 10, 10, 10]), and one of the last digit of each."""
A, B, C, K = np.array([[0, 10], [-10, 0]]), np.eye(2), np.array([[1, 10], [-10, 1]]), np.array([[1, -2], [0, 1]])
PRINTED_SATELLITE = 0.3754
"""test_mimo_disk_margin, at plant output and input: "disk margin of 0.3754"."""
AT = 200
"""Frequencies."""
TIMES = np.linspace(0.0, 60.0, 12_001)
SYSTEMS = {
    "1/(s + 1)": ([1.0], [1.0, 1.0]),
    "swings, 0.3": ([1.0], [1.0, 0.6, 1.0]),
    "swings, 0.7": ([1.0], [1.0, 1.4, 1.0]),
    "of its documentation": ([-1.0, 1.0], [1.0, 1.0, 1.0]),
}


def last_digits() -> Mapping[str, float]:
    """How far from what is printed of the lag, in units of the last digit."""
    from twin.studies.analyse.linear.margins import DiskMargin, smallest_disk

    omega = np.logspace(-1.0, 2.0, 1001)
    L = 25.0 / np.polyval((1.0, 10.0, 10.0, 10.0), 1j * omega)
    S = (1.0 / (1.0 + L)).astype(complex)
    disk = DiskMargin(smallest_disk(S[:, None, None])[1], 0.0)
    found = (disk.alpha, 20.0 * np.log10(disk.gain or np.inf), np.degrees(disk.phase))
    return {
        name: abs(ours - printed) / digit
        for (name, (printed, digit)), ours in zip(PRINTED_LAG.items(), found, strict=True)
    }


def satellite() -> Mapping[str, float]:
    """How far from what is printed of the spinning satellite, of the value."""
    from twin.studies.analyse.linear.margins import smallest_disk

    omega = np.logspace(-1.0, 3.0, 1001)
    found = {}
    for where, inputs, outputs in (("at its output", B @ K, C), ("at its input", B, K @ C)):
        # with the loop closed, S = 1 - C (s - A + B C)^-1 B
        inner = np.linalg.inv(1j * omega[:, None, None] * np.eye(2) - A + inputs @ outputs)
        found[where] = abs(smallest_disk(np.eye(2) - outputs @ inner @ inputs)[1] / PRINTED_SATELLITE - 1.0)
    return found


@cache
def pressing() -> Any:
    """Fig. 4's loops where it presses."""
    from twin.robot.assembly.load import load_experiment
    from twin.studies.analyse.linearised import Linearisation
    from twin.studies.analyse.operating_point import operating_points
    from validation.masters.robot import ROOT

    experiment = load_experiment(ROOT / "experiments" / "fig4_force_position.toml")
    points, _ = operating_points(experiment)
    return Linearisation(experiment, points).linear_point(next(point for point in points if point.in_contact))


def opened(breaks: Sequence[str]) -> Any:
    """The loop gain of Fig. 4's loops, cut at all `breaks` at once, for python-control."""
    import control

    from twin.studies.analyse.linear.loops import LOOPS, closed_loops

    at = pressing()
    cut = {name: gain for name, gain in at.gains.items() if name not in breaks}
    system = closed_loops(at.loops, cut)
    i, o = ([labels.index(name) for name in breaks] for labels in (system.input_labels, system.output_labels))
    motors = [k for k, name in enumerate(breaks) if name not in LOOPS]
    outputs, direct, sent = system.C[o], system.D[np.ix_(o, i)], system.B[:, i][:, motors]
    # what the laws command is not sent on
    state, inputs = system.A - sent @ outputs[motors], system.B[:, i] - sent @ direct[motors]
    return control.ss(state, inputs, -outputs, -direct, system.dt)


def beside_disk_margins() -> Mapping[str, float]:
    """Of Fig. 4's loops where it presses, at each frequency, of the value."""
    import control

    from twin.studies.analyse.linear.loops import SPEED_COMMANDS
    from twin.studies.analyse.linear.margins import sensitivity, smallest_disk

    at = pressing()
    omega = np.geomspace(0.1, 0.9 * np.pi / at.loops.dt, AT)
    found = {}
    for where, breaks in (
        ("laws", tuple(at.gains)),
        ("motors", SPEED_COMMANDS),
        ("both", (*at.gains, *SPEED_COMMANDS)),
    ):
        loop, S = opened(breaks), sensitivity(at.loops, at.gains, breaks, omega)
        for skew in (-1.0, 0.0, 1.0):
            theirs = control.disk_margins(loop, omega, skew=skew, returnall=True)[0]
            ours = np.array([smallest_disk(one[None], skew)[1] for one in S])
            found[f"{where}, skew {skew:g}"] = float(np.max(np.abs(ours / theirs - 1.0)))
    return found


def beside_step_info(names: Sequence[str], unit: float) -> Mapping[str, float]:
    """Metrics of step responses, in `unit`."""
    import control

    from twin.studies.metrics.response import step_info

    found: dict[str, float] = {}
    for label, (numerator, denominator) in SYSTEMS.items():
        y = np.asarray(control.step_response(control.tf(numerator, denominator), TIMES).outputs)
        theirs = control.step_info(y, TIMES)
        ours = step_info(TIMES, y, 0.0, 1.0)
        pairs = {
            "rise time": (ours.rise_time, theirs["RiseTime"]),
            "settling time": (ours.settling_time_2, theirs["SettlingTime"]),
            "overshoot": (ours.overshoot, theirs["Overshoot"] / 100.0),
            "final value": (ours.final, theirs["SteadyStateValue"]),
        }
        # the farthest point of a lag is where the samples end
        if theirs["Overshoot"] > 1.0:
            pairs["time of the peak"] = (ours.peak_time, theirs["PeakTime"])
        found |= {f"{name}, {label}": abs(pairs[name][0] - pairs[name][1]) / unit for name in names if name in pairs}
    return found


def step_times() -> Mapping[str, float]:
    return beside_step_info(("rise time", "settling time", "time of the peak"), TIMES[1])


def step_sizes() -> Mapping[str, float]:
    return beside_step_info(("overshoot", "final value"), 1.0)


SOURCE = "python-control"
YARDSTICKS = (
    Yardstick(
        "disk margin of one loop, 25/(s^3 + 10 s^2 + 10 s + 10): alpha, gain and phase as printed",
        f"printed in {SOURCE}'s tests, after Seiler, Packard and Gahinet, An Introduction to Disk Margins, 2020",
        "of the last digit",
        0.501,
        "half of the last digit that is printed",
        last_digits,
    ),
    Yardstick(
        "disk margin of two loops, the spinning satellite, all at once, at its input and at its output",
        f"printed in {SOURCE}'s tests, after MathWorks' documentation of diskmargin",
        "of the value",
        0.005,
        "what is printed is 0.3754, a safe side of a search over frequencies; at the lowest one that is looked at, 0.1 "
        "rad/s, python-control gives 0.37699 as the twin does, and at none at all 0.37615 is left",
        satellite,
    ),
    Yardstick(
        f"disk margins of Fig. 4's loops, pressing, opened at laws, motors and both, at each of {AT} frequencies",
        f"{SOURCE} with SLICOT's AB13MD",
        "of the value",
        1e-5,
        "both search the scaling with the smallest upper bound of mu, and it is one: rounding and where they stop",
        beside_disk_margins,
        ("control", "slycot"),
    ),
    Yardstick(
        "times of step responses: rise, settling within 2 %, peak",
        SOURCE,
        "samples",
        2.0,
        "python-control takes the first sample beyond a level, the twin the crossing between two samples, and a time "
        "to rise has two of them",
        step_times,
        ("control",),
    ),
    Yardstick(
        "overshoot and final value of step responses",
        SOURCE,
        "of the step",
        1e-5,
        "the final value is the last sample there and the mean of the last tenth here",
        step_sizes,
        ("control",),
    ),
)
