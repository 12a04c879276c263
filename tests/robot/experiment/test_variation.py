"""The same experiment with one thing changed: what is not named stays as it is."""

import pytest

from tests.laws.runs import shipped
from twin.kernel.errors import InputRefused
from twin.robot.experiment.experiment import Experiment, shorten, with_cosim

STEP = "step_force_scale"


def times(experiment: Experiment) -> list[float]:
    """Everything that is counted in ticks, in s."""
    ticks = [
        experiment.duration_ticks,
        experiment.controller_ticks,
        experiment.scale_ticks,
        experiment.controller.delay_ticks,
        experiment.controller.bus_delay_ticks,
        *(change.tick for change in experiment.changes),
    ]
    return [count * experiment.cosim.tick for count in ticks]


@pytest.mark.parametrize("share", [2.0, 1.0, 0.5, 0.125])
def test_with_another_tick_everything_is_as_long_and_as_late(share: float):
    experiment = shipped(STEP, "controller.delay_ticks=4", "controller.bus_delay_ticks=2")
    varied = with_cosim(experiment, tick=share * experiment.cosim.tick)
    # rounding
    assert times(varied) == pytest.approx(times(experiment), rel=1e-12)
    assert varied.cosim.tick == share * experiment.cosim.tick


@pytest.mark.parametrize(
    ("override", "share", "says"),
    [
        ("controller.delay_ticks=3", 2.0, "delay of 0.003 s"),
        ("controller.bus_delay_ticks=1", 2.0, "delay of the bus of 0.001 s"),
        ("change.1.t_s=20.001", 2.0, "time of a change of 20.001 s"),
        ("duration_s=45", 4.0, "controller of 0.002 s"),
    ],
)
def test_what_is_no_whole_number_of_ticks_is_refused_by_name(override: str, share: float, says: str):
    experiment = shipped(STEP, override)
    with pytest.raises(InputRefused, match=rf"^{STEP}: {says} is not a whole number of ticks of "):
        with_cosim(experiment, tick=share * experiment.cosim.tick)


def test_a_shorter_run_is_whole_periods_of_the_controller_long():
    assert shorten(shipped(STEP), 0.0031).duration_ticks == 4
    assert shorten(shipped(STEP), 1e3).duration_ticks == 45000
