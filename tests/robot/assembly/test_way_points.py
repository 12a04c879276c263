"""Shapes become way points that are where the shape is."""

from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import shipped
from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import joint_angles


def way(experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
    assert experiment.reference is not None
    return np.array(experiment.reference.t), np.array(experiment.reference.p)


def test_a_circle_has_its_radius_its_speed_and_its_sense():
    t, p = way(shipped("track_circle"))
    centre = np.array([0.0, 0.0, -0.095])
    # rounding
    assert np.allclose(np.linalg.norm(p - centre, axis=1), 0.015, atol=1e-15)
    assert np.all(p[:, 2] == -0.095)
    moving = t > 0.5
    speed = np.linalg.norm(np.diff(p[moving], axis=0), axis=1) / np.diff(t[moving])
    # chords of 2.5 mrad are shorter than their arcs by 3e-7
    assert np.allclose(speed, 2.0 * np.pi * 0.2 * 0.015, rtol=1e-6)
    quarter = np.searchsorted(t, 0.5 + 1.25)
    assert np.allclose(p[quarter], centre + np.array([0.0, 0.015, 0.0]), atol=1e-6)
    assert (t[0], t[1]) == (0.0, 0.5) and np.array_equal(p[0], p[1])
    assert t[-1] == pytest.approx(5.5) and np.allclose(p[-1], p[0])


def test_a_chirp_begins_and_ends_with_its_frequencies():
    t, p = way(shipped("track_chirp"))
    z = p[:, 2] + 0.095
    assert np.all(p[:, :2] == 0.0)
    # samples of the controller miss the crests by little
    assert np.max(np.abs(z)) == pytest.approx(0.003, rel=1e-3)
    # phase rate of a sine at zero is its slope over its amplitude
    slope = np.gradient(z, t) / 0.003 / (2.0 * np.pi)
    assert slope[2] == pytest.approx(0.05, rel=0.02)
    assert np.max(slope[t > 7.5]) == pytest.approx(1.0, rel=0.05)
    # (0.05 + 1)/2 Hz for 8 s are 4.2 turns
    assert np.sum((z[1:] > 0.0) & (z[:-1] <= 0.0)) == 5


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_after_a_joint_step_that_joint_alone_has_another_angle(joint: int):
    experiment = shipped(f"step_joint_{joint}")
    _, p = way(experiment)
    theta_l = joint_angles(geometry_of(experiment.controller.model), p)
    expected = np.zeros(3)
    expected[joint - 1] = np.radians(4.0)
    # rounding of two kinematics
    assert np.allclose(theta_l[-1] - theta_l[0], expected, atol=1e-12)
    assert p[-1, 2] < p[0, 2]


def test_a_shape_that_outlasts_the_experiment_ends_with_it():
    t, _ = way(shipped("track_circle", "reference.circle.turns=1000000000"))
    assert t[-1] == pytest.approx(6.0)


def experiment_with(folder: Path, reference: str) -> Experiment:
    file = folder / "mine.toml"
    file.write_text(f'extends = "fig4_position.toml"\n{reference}\n')
    return load_experiment(file)


def test_a_shape_replaces_the_way_points_of_the_file_below_and_way_points_a_shape(tmp_path: Path):
    shape = "[reference.circle]\ncentre_mm = [0.0, 0.0, -95.0]\nradius_mm = 5.0\nrate_Hz = 1.0\nturns = 1.0\n"
    circle = experiment_with(tmp_path, shape)
    assert circle.reference is not None and circle.reference.shape == "circle"
    assert not [key for key in circle.origins if key.startswith("reference.t_s")]
    (tmp_path / "below.toml").write_text((tmp_path / "mine.toml").read_text())
    above = tmp_path / "above.toml"
    above.write_text('extends = "below.toml"\n[reference]\nt_s = [0.0]\np_mm = [[0.0, 0.0, -90.0]]\n')
    again = load_experiment(above)
    assert again.reference is not None and again.reference.shape == ""


@pytest.mark.parametrize(
    ("name", "overrides", "said"),
    [
        ("track_circle", ["reference.circle.radius_mm=200"], r"\[reference.circle\] at 0 s: .*out of reach"),
        ("track_circle", ["reference.t_s=[0]"], "got way points, circle: expected either"),
        ("track_chirp", ["reference.chirp.end_Hz=60"], r"\[reference.chirp\] 60 Hz: expected at most 50 Hz"),
        ("track_chirp", ["reference.chirp.direction=w"], "expected 'x', 'y' or 'z'"),
        ("step_joint_1", ["reference.joint_step.point_mm=[0, 0, -300]"], r"\[reference.joint_step\] .*out of reach"),
        ("step_joint_1", ["reference.joint_step.step_deg=0"], "expected an angle other than 0"),
        ("step_joint_1", ["reference.joint_step.joint=4"], "joint = 4: expected 1, 2 or 3"),
    ],
)
def test_a_shape_that_cannot_be_followed_is_refused(name: str, overrides: list[str], said: str):
    with pytest.raises(InputRefused, match=said):
        shipped(name, *overrides)
