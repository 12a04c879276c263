"""A delay of the bus: everything that the drives are told comes so many ticks later, and nothing else does."""

import numpy as np

from tests.laws.runs import co_simulated, shipped
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.system import End
from twin.robot.assembly.assemble import COMPONENT_ROWS, connect_components

TICKS = 20
RUNAWAY = 'fault=[{kind="drive_runaway", target="drive_2", onset_s=0.4, magnitude_rad_per_s=8.0}]'


def test_speeds_and_power_reach_the_drives_so_many_ticks_later():
    run = co_simulated(shipped("pressing", RUNAWAY, f"controller.bus_delay_ticks={TICKS}"), 1.2)
    for name, before in (("omega_ref", np.zeros(3)), ("power", True)):
        told, reaches = run.held(f"monitor.{name}"), run.held(f"bus.{name}")
        assert np.array_equal(reaches[TICKS:], told[:-TICKS]), name
        assert np.all(reaches[:TICKS] == before), name
    power, speed = run.held("bus.power"), run.held("fault/1.omega_m")
    assert not power[-1]
    # a runaway turns as long as power reaches it; what holds at a tick acts in the step that begins there
    active = run.held("fault/1.active")[1:].astype(bool)
    assert np.array_equal(np.abs(speed[1:][active] - 8.0) < 1e-9, power[:-1][active])


def test_without_a_monitor_there_is_no_power_to_delay():
    run = co_simulated(shipped("fig4_force_position", f"controller.bus_delay_ticks={TICKS}"), 0.1)
    assert {name for name in run.fields() if name.startswith("bus.")} == {"bus.omega_ref"}
    assert np.array_equal(run.held("bus.omega_ref")[TICKS:], run.held("controller.omega_ref")[:-TICKS])


def test_where_there_is_a_bus_the_drives_have_both_from_it():
    both = (Port("omega_ref", 3, "rad/s"), Port("power"))
    made: dict[str, list[Component]] = {row.name: [] for row in COMPONENT_ROWS}
    for name in ("monitor", "bus"):
        made[name] = [Component(name, both, both, True, 0, 0, np.zeros(4))]
    made["drive"] = [Component("drive", (both[0], Port("enable", 3)), (), False, 0, 0, np.zeros(0))]
    feeds = connect_components(made)
    assert {feeds[End("drive", port, i)].component for port in ("omega_ref", "enable") for i in range(3)} == {"bus"}
    assert feeds[End("bus", "power")] == End("monitor", "power")
