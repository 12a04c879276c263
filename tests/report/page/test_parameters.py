import pytest

from twin.experiment.difference import flat, name_and_unit
from twin.recording.recording import Recording
from twin.report.page.parameters import differences, source
from twin.report.page.run import ReportRun
from twin.runs.assembly.declared import DECLARED


@pytest.mark.parametrize(
    ("key", "name", "unit"),
    [
        ("controller.force.kp_mm_per_N", "controller.force.kp", "mm/N"),
        ("controller.force.ki_mm_per_N_s", "controller.force.ki", "mm/(N s)"),
        ("controller.position.kp_per_s", "controller.position.kp", "1/s"),
        ("plant.k_s_Nm_per_rad", "plant.k_s", "N m/rad"),
        ("robot.I_r_kg_m2", "robot.I_r", "kg m²"),
        ("robot.N", "robot.N", ""),
        ("robot.m_p_g", "robot.m_p", "g"),
        ("duration_s", "duration", "s"),
        ("contact.friction", "contact.friction", ""),
        ("fault.1.magnitude_rad_per_s", "fault.1.magnitude", "rad/s"),
        ("drive.parameters.T_s", "drive.parameters.T_s", ""),
    ],
)
def test_the_unit_is_read_from_the_key(key: str, name: str, unit: str):
    assert name_and_unit(DECLARED, key) == (name, unit)


def test_every_value_of_a_run_has_a_source(force_position: Recording):
    run = ReportRun("fig4", force_position)
    without = [key for key, _ in flat(run.values) if not source(key, run.origins)]
    assert without == []
    assert source("plant.k_s_Nm_per_rad", run.origins).startswith("robot: Sec. III.A")


def test_only_what_differs_is_a_difference(force_position: Recording, position: Recording):
    runs = [ReportRun("a", force_position), ReportRun("b", position)]
    assert differences(runs) == [("controller.mode", "", "force_position", "position")]
    assert differences([runs[0], ReportRun("c", force_position)]) == []
