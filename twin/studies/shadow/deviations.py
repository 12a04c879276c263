"""Standard deviations of the filter's state for a healthy robot that differs from its twin's belief.

The filter's covariance assumes the believed encoders, springs and joints. Healthy robots differ from them
(docs/identification_method.md): encoder zeros, springs, dead zones and dry friction shift the estimate permanently, and
unknown encoder noise, which appears in the NIS, widens it. With J = d theta_l / d p_B and k = k_s N eta,

    var p_B = J^-1 zero_l^2 J^-T,  var theta_m = zero_m^2,
    var F = J^T [(k (1 + N) zero)^2 + (k dead_zone)^2 + friction^2 + (spring tau_l)^2] J   per leg.
"""

import numpy as np
from numpy.typing import NDArray

from twin.robot.assembly.build import plant_parameters
from twin.robot.experiment.experiment import Experiment
from twin.studies.shadow.contact_estimate import ENCODER_ZERO, JOINT_FRICTION
from twin.studies.shadow.layout import FORCE, MOTOR, POSITION, STATES

SPRING_ERROR, DEAD_ZONE_ERROR = 0.04, 1.0
"""Largest relative errors of unidentified springs and dead zones in the shipped fleet of healthy robots."""
DEVIATION_SHARE = 0.75
"""Standard deviation by the largest error. At the corners of the fleet, where several causes are largest at once, at
most a tenth of all samples exceeds 1.96 deviations."""
SPRING_KEY, DEAD_ZONE_KEY = "plant.k_s_Nm_per_rad", "plant.backlash_deg"
NOT_IDENTIFIED = "this robot was not identified yet: `twin identify`"
NIS_SAMPLES = 500


def is_identified(experiment: Experiment, key: str) -> bool:
    """Check whether a value of [plant], or its source in [robot], was identified by `twin identify`."""
    origins = experiment.origins
    return origins.get(key, origins.get(key.replace("plant.", "robot.", 1), "")).startswith("identified")


class HealthyDeviation:
    """Conversion of the filter's standard deviations to the larger deviations for a healthy robot, slice by slice."""

    def __init__(self, experiment: Experiment):
        plant = plant_parameters(experiment.plant, experiment.contact)
        self._spring, dead_zone = (
            0.0 if is_identified(experiment, key) else error
            for key, error in ((SPRING_KEY, SPRING_ERROR), (DEAD_ZONE_KEY, DEAD_ZONE_ERROR))
        )
        k = plant.k_s * plant.N * plant.eta
        torque = (k * (1.0 + plant.N) * ENCODER_ZERO) ** 2 + (k * dead_zone * plant.backlash) ** 2 + JOINT_FRICTION**2
        self._torque = DEVIATION_SHARE**2 * torque
        self._NIS, self._used = 0.0, 0.0

    def widen(
        self, deviation: NDArray[np.float64], NIS: NDArray[np.float64], used: NDArray[np.float64],
        J: NDArray[np.float64], tau_l: NDArray[np.float64],
    ) -> NDArray[np.float64]:  # fmt: skip
        """Widen the filter's deviations (n, 15) by NIS and new counts (n,), J (n, 3, 3) and tau_l (n, 3)."""
        added = np.zeros((len(deviation), STATES))
        with np.errstate(invalid="ignore", divide="ignore"):
            away = np.linalg.pinv(np.where(np.isfinite(J), J, 0.0))
        added[:, POSITION : POSITION + 3] = (DEVIATION_SHARE * ENCODER_ZERO) ** 2 * np.sum(away**2, axis=2)
        added[:, MOTOR : MOTOR + 3] = (DEVIATION_SHARE * ENCODER_ZERO) ** 2
        torque = self._torque + (DEVIATION_SHARE * self._spring * tau_l) ** 2
        added[:, FORCE : FORCE + 3] = np.einsum("nji,nj->ni", J**2, torque)
        spread = self._mean_nis(NIS, used)
        return np.asarray(np.sqrt(deviation**2 * spread[:, None] + added))

    def _mean_nis(self, NIS, used) -> NDArray[np.float64]:
        """Average the NIS per encoder count over `NIS_SAMPLES` samples; at least 1."""
        keep = 1.0 - 1.0 / NIS_SAMPLES
        spread = np.empty(len(NIS))
        for k, (square, count) in enumerate(zip(np.nan_to_num(NIS).tolist(), used.tolist(), strict=True)):
            self._NIS, self._used = keep * self._NIS + square, keep * self._used + count
            spread[k] = self._NIS / self._used if self._used > 0.0 else 1.0
        return np.maximum(spread, 1.0)
