"""The robot's table: what an experiment makes of it."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import FORCE, shipped
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.errors import InputRefused
from twin.kernel.fmi import unpacked as drives
from twin.robot.assembly.assemble import COMPONENT_ROWS, assemble
from twin.robot.experiment.experiment import Experiment

ALONE = ["encoder", "estimator", "controller", "scale", "drive_1", "drive_2", "drive_3", "plant"]
TOLD = ("reference", "remote")
"""Only a third-party controller has a reference (test_roles.py), only a served robot a remote one."""
EVERYTHING = (
    "controller.delay_ticks=1", "controller.bus_delay_ticks=1", "monitor.enabled=true", "cosim.inputs='linear'",
    "contact.shift={by_mm=[0,0,1],start_s=1,rise_s=1}", "plant.encoder_latency_ms=1",
    "controller.energy_tank.size_J=1", "drive.unpowered.holding_Nm=0.02",
)  # fmt: skip


def rows_of(experiment: Experiment) -> dict[str, Component]:
    """A component of each row that the experiment has, in the order of a tick."""
    with assemble(experiment) as assembly:
        components = assembly.system.components
    return {re.sub(r"_\d$", "", component.name): component for component in components}


def test_a_plain_experiment_has_no_more_than_it_needs():
    with assemble(shipped()) as assembly:
        assert [component.name for component in assembly.system.components] == ALONE


def test_the_files_of_three_equal_drives_are_looked_at_once_for_each_robot(monkeypatch: pytest.MonkeyPatch):
    looked_at: list[str] = []

    def unpacked(file: Path, digest: str) -> Path:
        looked_at.append(digest)
        return drives.unpacked(file, digest)

    monkeypatch.setattr("twin.robot.assembly.drives.unpacked", unpacked)
    for robots in (1, 2):
        with assemble(shipped()) as assembly:
            assert len(assembly.drives) == 3
        assert len(looked_at) == robots


def test_a_tick_goes_through_the_table_from_top_to_bottom():
    assert list(rows_of(shipped(FORCE, *EVERYTHING))) == [row.name for row in COMPONENT_ROWS if row.name not in TOLD]


@pytest.mark.parametrize("name", [FORCE, "pressing"])
def test_every_source_in_the_table_is_an_output_of_its_row(name: str):
    offered = {row: [port.name for port in part.outputs] for row, part in rows_of(shipped(name, *EVERYTHING)).items()}
    for row in (one for one in COMPONENT_ROWS if one.name in offered):
        for port, sources in row.inputs.items():
            for owner, output in sources:
                assert owner in TOLD or output in offered[owner], f"{row.name}.{port}"


class Nothing:
    """An estimator that forgot what the controller needs."""

    inputs = (Port("count_m", 3), Port("count_l", 3))
    sampled = True

    def __init__(self, *outputs: Port):
        self.outputs = outputs

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None: ...


@pytest.mark.parametrize(
    ("outputs", "said"),
    [
        ((Port("p", 3),), "estimator: has no output 'p_B', which controller.p_B needs; it has p"),
        ((Port("p_B", 2),), "wire estimator.p_B -> controller.p_B: 2 values into 3"),
    ],
)
def test_a_substitute_that_does_not_fit_is_refused_in_a_sentence(outputs: tuple[Port, ...], said: str):
    with pytest.raises(InputRefused, match=re.escape(said)):
        assemble(shipped(), {"estimator": PythonComponent("estimator", Nothing(*outputs))})


def test_a_substitute_that_has_no_place_is_refused_before_any_drive_is_made():
    def never(*arguments: object) -> Component:
        raise AssertionError

    class Maker:
        one_process = True
        drive = staticmethod(never)

    with pytest.raises(InputRefused, match="no component 'drive_4' in this experiment; did you mean 'drive_"):
        assemble(shipped(), {"drive_4": PythonComponent("drive_4", Nothing())}, Maker())


def test_a_drive_that_is_substituted_is_not_made():
    made = []

    class Maker:
        one_process = True

        @staticmethod
        def drive(name: str, *rest: object) -> Component:
            made.append(name)
            return PythonComponent(name, Shaft(), initial_outputs=[0.0])

    class Shaft(Nothing):
        inputs = (Port("omega_ref"), Port("tau_load"))

        def __init__(self) -> None:
            super().__init__(Port("theta_m"))

    Shaft.sampled = False
    assemble(shipped(), {"drive_2": PythonComponent("drive_2", Shaft())}, Maker())
    assert made == ["drive_1", "drive_3"]
