"""Every open parameter set at once: the FMU does what an experiment with those values does, bit for bit."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.studies.build.conftest import DELAYED, FIG4, MASSAGE, ROOT
from tests.studies.build.slaves import Kept, Slave
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import run_in_memory
from twin.studies.build.part import START_KEY, OpenParameter, open_parameters, part_of

TICKS = 1500
BREATHING = ROOT / "experiments" / "track_breathing.toml"
SHIFTED = (
    "contact.shift={by_mm=[0.5,0.0,1.0],start_s=0.3,rise_s=0.2,end_s=1.0}", "contact.shape=sphere",
    "contact.radius_mm=80", "contact.tilt_deg=3", "contact.height_mm=-93", "plant.spring_stop_deg=2",
)  # fmt: skip
DEEP = ("contact.height_mm=-85.5", "plant.eta_rate_rad_per_s=0.5", "plant.eta=0.9")
ADAPTIVE = (
    "contact.height_mm=-87", "approach.height_mm=-78", "controller.touch.force_learning=0.4",
    "controller.tissue.window_s=0.4", "controller.breath.rate_per_min=14", "monitor.enabled=false",
    "controller.force.schedule=[{stiffness_N_per_m=800,kp_mm_per_N=1.5,ki_mm_per_N_s=18},"
    "{stiffness_N_per_m=2000,kp_mm_per_N=1.8,ki_mm_per_N_s=11}]",
)  # fmt: skip
TANK = ("controller.energy_tank={size_J=0.02,release_s=0.5}", "contact.height_mm=-86")
WATCHED = ("monitor={command_limit_rad_per_s=7.0}", "contact.height_mm=-86")


def another(parameter: OpenParameter, n: int) -> list[float]:
    """Values a little off those of the experiment, of each parameter by another share."""
    if "counts" in parameter.key:
        return [round(1.01 * value) for value in parameter.start]
    return [value * (1 - 0.003 * (n % 5 + 1)) if value else 0.002 * (n % 3 + 1) for value in parameter.start]


@pytest.mark.parametrize(
    ("experiment", "part", "settings"),
    [
        (BREATHING, "plant", SHIFTED),
        (MASSAGE, "computer", DELAYED),
        pytest.param(MASSAGE, "computer", ADAPTIVE, marks=pytest.mark.endurance),
        pytest.param(FIG4, "plant", DEEP, marks=pytest.mark.endurance),
        pytest.param(FIG4, "computer", WATCHED, marks=pytest.mark.endurance),
        pytest.param(FIG4, "computer", TANK, marks=pytest.mark.endurance),
    ],
)
def test_all_parameters_at_once_do_what_the_experiment_with_them_does(
    built: Callable[..., Path], experiment: Path, part: str, settings: tuple[str, ...]
) -> None:
    found = open_parameters(part_of(load_experiment(experiment, settings), part))
    values = {p.key: another(p, n) for n, p in enumerate(found) if p.key != START_KEY}
    said = [f"{key}={value if len(value) > 1 else value[0]}" for key, value in values.items()]
    run = run_in_memory(replace(load_experiment(experiment, [*settings, *said]), duration_ticks=TICKS))
    theta_m, theta_l = run.of_drives("theta_m"), run.held("plant.theta_l")
    is_plant = part == "plant"
    inputs = {"theta_m": theta_m[0]} | ({} if is_plant else {"theta_l": theta_l[0]})
    slave = Slave(built(part, "2.0", settings, str(experiment)), values, inputs).ready()
    names = [name for name in run.fields() if any(v.startswith(name) for v in slave.variables)]
    names = [name for name in names if f"{name}[1]" in slave.variables or name in slave.variables]
    assert len(names) >= 10
    kept = Kept(slave, names, TICKS + 1)
    if is_plant:
        assert np.ptp(run.held("scale.F_z")) > 0.0
    kept.keep(0)
    for k in range(TICKS):
        slave.set({"theta_m": theta_m[k + 1]} if is_plant else {"theta_m": theta_m[k], "theta_l": theta_l[k]})
        slave.step(k)
        kept.keep(k + 1)
    slave.close()
    for name in names:
        held = np.asarray(run.held(name), dtype=float)
        if name.startswith("plant."):
            assert np.array_equal(kept[name], held), name
        else:
            assert np.array_equal(kept[name][1:], held[:-1]), name
