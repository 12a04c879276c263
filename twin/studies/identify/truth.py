"""What was true in a run of the twin, to score an identification by. Nothing else looks here."""

from collections.abc import Mapping

import numpy as np

from twin.robot.experiment.schema import Cosim
from twin.robot.plant.dynamics import TrueRobot, series_share, spring_stiffness
from twin.studies.replay.model import RobotModel


def truth(model: RobotModel) -> Mapping[str, float]:
    """The plant's values by the names of `identification.Quantity`, SI.

    The viscous friction is what encoders that are read in the same instant show of it. A co-simulation holds the motor
    angle over its tick H: the spring sees it half a tick early (Gauss-Seidel) or late (Jacobi), which is a torque
    k_s eta N^2 H/2 theta_l' along or against the motion (docs/physics.md, "Springs are inside the plant").
    """
    plant = TrueRobot.model_validate(model.values["plant"])
    surface = model.plant
    k_s = spring_stiffness(surface, 0) * series_share(surface, 0)
    k = k_s * plant.eta
    motor, joint = np.array(plant.motor_zero), np.array(plant.joint_zero)
    scheme = Cosim.model_validate(model.values.get("cosim", {})).scheme
    early = 0.5 * model.tick if scheme == "gauss_seidel" else -0.5 * model.tick
    directed = plant.eta_rate > 0.0
    return {
        "k_s_eta": k_s if directed else k,
        "k_s": k_s,
        "eta": plant.eta,
        **{f"deflection_zero_{i + 1}": float(motor[i] - plant.N * joint[i]) for i in range(3)},
        **{f"joint_zero_{i + 1}": float(joint[i]) for i in range(3)},
        "backlash": plant.backlash,
        "b_j": plant.b_j - k * plant.N**2 * early,
        "height": surface.z_s,
        # the normal of `surface_frame` of the plant leans towards +x and -y
        "slope_x": -float(np.tan(surface.tilt)),
        "slope_y": float(np.tan(surface.tilt_x)),
        "stiffness": surface.K,
        "damping": surface.damping,
        "delay": 0.0,
        "friction": surface.mu,
    }
