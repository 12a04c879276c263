from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import PARAMETERS
from tests.studies.paper.fig5_recordings import pressed
from twin.kernel.recording.reader import Recording
from twin.report.page.markup import DataBlock
from twin.report.page.panels import scene, surface
from twin.report.page.run import ReportRun
from twin.robot.plant.contact import Shape, surface_frame
from twin.studies.packing import values_of


def test_every_link_of_the_player_has_its_length(force_position: Recording):
    block = DataBlock()
    shown = scene(ReportRun("", force_position), block)
    assert shown is not None
    n = shown["frames"]["count"]
    assert n == 1001 and shown["frames"]["step"] == 0.02
    columns = values_of(block.text()).reshape(-1, n).T
    A, p_B = columns[:, :9].reshape(n, 3, 3), columns[:, 9:12]
    B, P = np.array(shown["B"]), p_B[:, None, :] + np.array(shown["platform"])
    # 32 bit floats of 100 mm are 1e-5 mm apart
    np.testing.assert_allclose(np.linalg.norm(A - B, axis=2), 60.0, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(P - A, axis=2), 113.9, atol=1e-4)


def test_the_force_of_the_player_is_the_recorded_one(force_position: Recording):
    block = DataBlock()
    shown = scene(ReportRun("", force_position), block)
    assert shown is not None
    columns = values_of(block.text()).reshape(-1, shown["frames"]["count"]).T
    np.testing.assert_array_equal(columns[:, 15:18], force_position["plant.F_ee_B"][::20].astype(np.float32))
    np.testing.assert_array_equal(columns[:, 18:21], force_position["estimator.F_ee_B"][::10].astype(np.float32))


@pytest.mark.parametrize("shape", [shape.name.lower() for shape in Shape])
def test_the_drawn_surface_is_where_the_depth_is_zero(shape: str):
    contact = {"height_mm": -101.0, "tilt_deg": 7.0, "tilt_x_deg": -4.0, "shape": shape}
    if shape != "plane":
        contact["radius_mm"] = 80.0

    apex = PARAMETERS._replace(
        tilt=np.radians(7.0), tilt_x=np.radians(-4.0), z_s=-0.101, shape=int(Shape[shape.upper()]), radius=0.08
    )
    for x, y, z in 1e-3 * np.reshape(surface(contact), (-1, 3)):
        depth, *_ = surface_frame(apex, x, y, z)
        # points are told to 0.1 um
        assert abs(depth) < 2e-7


def test_a_run_without_joint_angles_has_no_scene(tmp_path: Path):
    assert scene(ReportRun("", pressed(tmp_path)), DataBlock()) is None
