import pytest

from twin.kernel.errors import InputRefused
from twin.studies.qualify import definitions as workload
from twin.studies.qualify.bench import reporting_ticks
from twin.studies.qualify.definitions import EXPECTED_TICKS, Workload
from twin.studies.qualify.motion import carries_load


def test_a_check_that_would_take_more_than_an_hour_is_ended_unless_it_is_meant():
    with pytest.raises(InputRefused, match=r"^servo: a step takes 100 ms, and the whole .* 2.1 hours; add --yes"):
        Workload("servo", sure=False).count_ticks(110, 11.0)
    Workload("servo", sure=True).count_ticks(110, 11.0)
    # 20 ms are 25 minutes
    Workload("servo", sure=False).count_ticks(550, 11.0)


def test_how_far_it_is_and_what_a_step_takes_is_said(monkeypatch: pytest.MonkeyPatch):
    said: list[tuple[str, float | None]] = []
    clock = iter([0.0, 30.0, 31.5, 31.5])
    monkeypatch.setattr(workload.time, "monotonic", lambda: next(clock))
    load = Workload("servo", lambda what, share=None: said.append((what, share)))
    load.count_ticks(EXPECTED_TICKS // 4, 0.5)
    load.count_ticks(EXPECTED_TICKS // 4, 59.5)
    assert said == [("servo, 1.6 ms a step", 0.5)]


def test_every_tick_of_the_bench_is_counted(done):
    plan, ticks = done("velocity_servo").plan, []
    with reporting_ticks(lambda count, taken: ticks.append(count)):
        carries_load(plan, 0.1)
    # 0.5 s, the ramp of 0.4 s and the hold of 1 s
    assert sum(ticks) == 1900
    carries_load(plan, 0.1)
    assert sum(ticks) == 1900
