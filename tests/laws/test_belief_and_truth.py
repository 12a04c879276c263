"""The controller's belief and the plant's truth are separate: a wrong one is wrong by what statics predicts."""

import numpy as np
import pytest

from tests.laws.runs import EXACT_ENCODERS, FORCE, POSITION, ComponentStepper, co_simulated, shipped
from twin.robot.assembly.build import belief, controller, plant_parameters
from twin.robot.controller.controller import Estimator
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian
from twin.robot.mechanism.statics import arm_gravity_torque, platform_weight

NO_BACKLASH = (*EXACT_ENCODERS, "plant.backlash_deg=0")
WRONG = {
    "stiffness": "plant.k_s_Nm_per_rad=1.2",
    "platform": "plant.m_p_g=150",
    "arms": "plant.m_a_g=80",
    "rods": "plant.m_b_g=60",
    "efficiency": "plant.eta=0.8",
    "backlash": "plant.backlash_deg=0.3",
}

DIRECTED = ("plant.eta=0.8", "plant.eta_rate_rad_per_s=0.2", "controller.model.eta=0.8")
"""A belt that loses in the direction of the flow, and a controller that takes its efficiency for constant: robots at
rest have no losses."""


def predicted_force_error(experiment, rows, tick):
    """F_ee_B estimated less true (3,), N, of a robot at rest: the statics of belief less those of truth."""
    true, believed = plant_parameters(experiment.plant, experiment.contact), belief(experiment)
    theta_l, tau_l = rows["plant.theta_l"][tick], rows["plant.tau_l"][tick]
    J = jacobian(Geometry(*true[:4]), rows["plant.p_B"][tick])
    # the backlash hides in the deflection that the encoders see
    deflection = rows["plant.tau_load"][tick] / true.k_s
    seen = deflection + np.sign(deflection) * true.backlash
    torque_error = believed.k_s * believed.N * believed.eta * seen - tau_l
    for leg in range(3):
        torque_error[leg] += arm_gravity_torque(believed, believed, theta_l[leg])
        torque_error[leg] -= arm_gravity_torque(true, true, theta_l[leg])
    weight_error = platform_weight(believed) - platform_weight(true)
    return J.T @ torque_error - [0.0, 0.0, weight_error]


@pytest.mark.parametrize("overrides", [*((one,) for one in WRONG.values()), DIRECTED], ids=[*WRONG, "directed losses"])
def test_estimate_is_wrong_by_what_statics_predicts(overrides):
    experiment = shipped(POSITION, *NO_BACKLASH, *overrides)
    rows = co_simulated(experiment)
    # at rest at the start, in air; and at the end, pressing
    for tick, tolerance in ((0, 1e-8), (20_000, 2e-3)):
        error = rows.held("estimator.F_ee_B")[tick] - rows["plant.F_ee_B"][tick]
        # counts of 6e-12 rad make 1e-9 N; at the end the servos still creep, and 5e-3 N m s/rad of joint friction makes
        # 1e-3 N of that
        expected = predicted_force_error(experiment, rows, tick)
        np.testing.assert_allclose(error, expected, rtol=0, atol=tolerance)
        assert np.abs(expected).max() > 0.05


def test_estimate_is_right_where_belief_is_truth():
    rows = co_simulated(shipped(POSITION, *NO_BACKLASH))
    error = rows.held("estimator.F_ee_B") - rows["plant.F_ee_B"]
    assert np.abs(error[0]).max() < 1e-8
    # what is left is 0.3 kg of acceleration and the joints' friction at a few mm/s
    assert np.abs(error).max() < 0.05
    assert np.abs(error[-1]).max() < 2e-3


@pytest.mark.parametrize("override", WRONG.values(), ids=WRONG.keys())
def test_same_encoder_counts_give_the_same_bits_whatever_the_plant_is(override):
    counts_m, counts_l = (co_simulated(shipped(), 8.0)[f"encoder.count_{side}"] for side in "ml")

    def replayed(experiment):
        estimator = ComponentStepper(Estimator(belief(experiment), experiment.controller.gravity_compensation))
        law = ComponentStepper(controller(experiment))
        outputs = []
        for k, counts in enumerate(np.hstack([counts_m, counts_l])):
            estimate = estimator(counts)
            outputs.append([*estimate, *law(estimate[[*range(6, 18), 21, 22, 23]], k * 2e-3, 2e-3)])
        return np.array(outputs)

    believed_true, believed_wrong = replayed(shipped()), replayed(shipped(FORCE, override))
    assert believed_true[-1, 25 + 10] == 1.0, "the replay reaches the force loop"
    assert believed_true.tobytes() == believed_wrong.tobytes()


def test_the_replay_is_what_the_controller_did_in_the_run():
    rows = co_simulated(shipped(), 8.0)
    counts = np.hstack([rows["encoder.count_m"], rows["encoder.count_l"]])
    estimator, law = ComponentStepper(Estimator(belief(shipped()))), ComponentStepper(controller(shipped()))
    for k, count in enumerate(counts):
        found = law(estimator(count)[[*range(6, 18), 21, 22, 23]], k * 2e-3, 2e-3)
        np.testing.assert_array_equal(found[:3], rows["controller.omega_ref"][k])
