"""A master that does something wrong is told from one that does not: the bounds can be exceeded."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import Trace, run_in_memory
from validation.masters.master import BIT_FOR_BIT, ROUNDING
from validation.masters.robot import JACOBI, differences
from validation.yardsticks.omsimulator import SUMMED

Signals = dict[str, np.ndarray]


@cache
def own(*settings: str) -> Trace:
    """Two seconds of Fig. 4: approach and touch."""
    path = Path(__file__).parents[2] / "experiments" / "fig4_force_position.toml"
    return run_in_memory(load_experiment(path, ["duration_s=2", *JACOBI, *settings]))


def as_another_master_gives_it(run: Trace) -> Signals:
    """The signals of a run as a master that is without fault gives them."""
    found = {}
    for key in run.fields():
        values = run.held(key).astype(float).reshape(len(run.t), -1)
        if key.startswith("drive/"):
            key = key.replace("drive/", "drive_")
        elif not key.startswith("plant."):
            values = np.vstack([np.zeros((1, values.shape[1])), values[:-1]])
        found[key] = values
    return found


def test_a_master_without_fault_differs_in_nothing():
    found = differences(as_another_master_gives_it(own()), own())
    assert len(found) > 30
    assert max(found.values()) == 0.0


def later(signals: Signals) -> None:
    """The command reaches the drives, and all that is recorded, one step late."""
    for key in signals:
        signals[key] = np.vstack([signals[key][:1], signals[key][:-1]])


def nearly(signals: Signals) -> None:
    signals["plant.v_B"] = signals["plant.v_B"] + 1.1 * ROUNDING * np.ptp(signals["plant.v_B"])


def unheard(signals: Signals) -> None:
    signals["plant.F_n"][700:] = np.nan


@pytest.mark.parametrize("spoil", [later, nearly, unheard])
def test_a_trace_that_is_late_or_off_or_not_there_exceeds_the_bound(spoil: Callable[[Signals], None]):
    signals = as_another_master_gives_it(own())
    spoil(signals)
    assert not all(value <= ROUNDING for value in differences(signals, own()).values())


@pytest.mark.parametrize(
    ("setting", "bound"),
    [
        ("plant.k_s_Nm_per_rad=1.000000001", SUMMED),
        # far beyond rounding: a share of the range that is seen in a picture
        ("controller.bus_delay_ticks=2", 0.1),
        ("cosim.scheme=gauss_seidel", 0.1),
    ],
)
def test_a_master_that_runs_another_robot_or_in_another_order_exceeds_the_bound(setting: str, bound: float):
    assert max(differences(as_another_master_gives_it(own(setting)), own()).values()) > bound


def test_a_last_bit_exceeds_the_bound_of_a_claim_to_the_same_bits():
    signals = as_another_master_gives_it(own())
    signals["plant.p_B"][1500, 2] = np.nextafter(signals["plant.p_B"][1500, 2], 0.0)
    assert max(differences(signals, own()).values()) > BIT_FOR_BIT


def test_signals_that_are_on_one_side_only_are_noticed():
    signals = as_another_master_gives_it(own())
    del signals["plant.p_B"]
    with pytest.raises(ValueError, match=r"on one side only: plant\.p_B"):
        differences(signals, own())
