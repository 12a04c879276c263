import numpy as np

from twin.kernel.cosim.playback import columns, play
from twin.robot.mechanism.statics import G_ACCELERATION
from twin.robot.plant.encoder import Scale


def test_a_component_played_over_inputs_gives_what_it_would_give_in_a_run():
    force = -np.linspace(-1.0, 6.0, 50)
    u = np.zeros((50, 3))
    u[:, 2] = force
    scale = Scale(0.005 * G_ACCELERATION)
    rows, status = play(scale, np.arange(50.0), np.ones(50), u)
    steps = np.floor(-force / (0.005 * G_ACCELERATION) + 0.5)
    assert status == 0
    np.testing.assert_array_equal(columns(scale, rows)["F_z"], steps * (0.005 * G_ACCELERATION))


def test_rows_are_taken_after_as_many_steps_as_asked_for():
    u = np.zeros((6, 3))
    u[:, 2] = -np.arange(6.0)
    rows, _ = play(Scale(1.0), np.arange(6.0), np.ones(6), u, np.array([1, 3, 2]))
    np.testing.assert_array_equal(rows[:, 0], [0.0, 3.0, 5.0])
