"""Where values of ports lie for the FMU's calls."""

from pathlib import Path

import pytest

from tests.robot.assembly.test_roles import planned
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.stepping import FmuPort, Stepping, port_slots


@pytest.mark.parametrize(("side", "access"), [("input", "Set"), ("output", "Get")])
def test_there_is_room_for_every_value_and_for_the_one_before(root: Path, side: str, access: str):
    plan = planned(root / "fmus" / "parts" / "paper_law" / "paper_law.fmu")
    ports = [FmuPort(b.port, b.variable, b.gain, b.offset) for b in plan.bindings if b.role.causality == side]
    component = plan.part("controller", 1e-3, 2, 10)
    assert isinstance(component, FmuComponent)
    try:
        stepping = Stepping(component.instance)
        table = stepping._group_table(port_slots(ports), access)
    finally:
        component.close()
    sizes = [int(row["bytes"]) for row in table for _ in ("buffer", "last")]
    assert [array.nbytes for array in stepping._moving] == sizes
    assert {int(row["bytes"]) // int(row["values"]) for row in table} <= {4, 8}


def test_a_value_of_a_port_goes_to_the_fmu_and_back(root: Path):
    (binding, *_) = planned(root / "fmus" / "parts" / "paper_law" / "paper_law.fmu").bindings
    celsius = FmuPort(binding.port, binding.variable, gain=1.0, offset=273.15)
    assert celsius.to_fmu(298.15) == pytest.approx(25.0, rel=1e-12)
    assert FmuPort(binding.port, binding.variable, gain=2.0, offset=-1.0).to_fmu(5.0) == 3.0
