"""A master in some lines: computer, three drives and plant, all of them slaves."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.studies.build.slaves import Kept, Slave

PLANT = [
    "plant.p_B", "plant.v_B", "plant.theta_l", "plant.omega_l", "plant.tau_l", "plant.tau_load", "plant.F_ee_B",
    "plant.F_n", "plant.z_b", "scale.F_z",
]  # fmt: skip
COMPUTER = [
    "encoder.count_m", "encoder.count_l", "estimator.theta_m", "estimator.p_B", "estimator.J", "estimator.tau_l",
    "estimator.F_ee_B", "controller.omega_ref", "controller.p_ref_B", "controller.p_cmd_B", "controller.dp_z",
    "controller.triggered", "controller.F_z",
]  # fmt: skip


def looped(
    plant: Slave, computer: Slave, drive: Path, droop: float, theta_m: NDArray[np.float64], ticks: int, jacobi: bool
) -> tuple[Kept, Kept, NDArray[np.float64]]:
    """Fig. 4 in another master: what plant and computer gave, and the motor angles (ticks + 1, 3).

    Args:
        plant, computer: initialised.
        drive: FMU of each joint, with the parameter droop.
        theta_m: motor angles at the start (3,), rad: a drive counts from its own zero.
        ticks: how many steps of 1 ms.
        jacobi: whether all see what was valid at the beginning of the step; else computer, drives and plant see each
            other's newest values.
    """
    torque = plant.get("plant.tau_load")
    drives = [Slave(drive, {"droop": droop}, {"tau_load": torque[i]}).ready() for i in range(3)]
    kept = Kept(plant, PLANT, ticks + 1), Kept(computer, COMPUTER, ticks + 1)
    angles = np.zeros((ticks + 1, 3))
    angles[0] = theta_m
    kept[0].keep(0)
    speed, load, shaft = (computer.references("controller.omega_ref"), plant.references("plant.tau_load"), [
        drive.references("theta_m") for drive in drives
    ])  # fmt: skip
    seen = computer.references("theta_m") + computer.references("theta_l")
    turned, link = plant.references("theta_m"), plant.references("plant.theta_l")
    ends = [drive.references("omega_ref") + drive.references("tau_load") for drive in drives]
    for k in range(ticks):
        tau, omega = plant.take(load), computer.take(speed)
        computer.put(seen, [*angles[k], *plant.take(link)])
        computer.step(k)
        kept[1].keep(k)
        if not jacobi:
            omega = computer.take(speed)
        for i, drive_ in enumerate(drives):
            drive_.put(ends[i], [omega[i], tau[i]])
            drive_.step(k)
            angles[k + 1, i] = drive_.take(shaft[i])[0] + theta_m[i]
        plant.put(turned, angles[k] if jacobi else angles[k + 1])
        plant.step(k)
        kept[0].keep(k + 1)
    for slave in (*drives, plant, computer):
        slave.close()
    return *kept, angles
