"""Drives, springs, mechanism and contact from one call of the controller to the next, as the master steps them.

The map of one tick is put together from the parts' own maps in the master's order (`twin/cosim/master.py`): the drives
see omega_ref(k) and tau_load(k), then the plant sees theta_m(k+1), or theta_m(k) with the Jacobi scheme. So poles and
gains are those of the co-simulation, its coupling error included, not of the differential equations behind it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np

from twin.studies.analyse.linear.drive_model import DriveModel, Matrix

MEASURED = ("theta_m_1", "theta_m_2", "theta_m_3", "theta_l_1", "theta_l_2", "theta_l_3")
TRUE = ("p_B_x", "p_B_y", "p_B_z", "F_ee_B_z")
COMMANDS = ("omega_ref_1", "omega_ref_2", "omega_ref_3")
LOADS = ("tau_load_1", "tau_load_2", "tau_load_3")


class Stepping(NamedTuple):
    """How the co-simulation steps.

    Attributes:
        tick: s.
        substeps: of the plant per tick.
        period: ticks between two calls of the controller.
        delay: ticks from its call to the drives.
        jacobi: all continuous components see what is valid at the tick; else the plant sees the drives' newest angles.
    """

    tick: float
    substeps: int
    period: int
    delay: int
    jacobi: bool


def runge_kutta_step(A: Matrix, B: Matrix, h: float, substeps: int) -> tuple[Matrix, Matrix]:
    """(A_d, B_d) of dx/dt = A x + B u over `h` (s), u held: what the plant's integrator makes of it.

    Classical Runge-Kutta multiplies a linear state by R(h A), R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24 (Hairer and Wanner
    1996, Solving Ordinary Differential Equations II, IV.2); the derivative of its step at a state of rest is the same.
    """
    z = A * (h / substeps)
    one = np.eye(len(A))
    input_share = one + z / 2.0 @ (one + z / 3.0 @ (one + z / 4.0))
    A_1, B_1 = one + z @ input_share, h / substeps * input_share @ B
    A_d, B_d = one, np.zeros_like(B)
    for _ in range(substeps):
        A_d, B_d = A_1 @ A_d, A_1 @ B_d + B_1
    return A_d, B_d


def tick_map(plant: control.StateSpace, drives: Sequence[DriveModel], stepping: Stepping) -> control.StateSpace:
    """One tick: commands `COMMANDS` in, `MEASURED` and `TRUE` out, all as small deviations.

    Args:
        plant: linearised, continuous time, inputs theta_m_1 .. 3, outputs with the names used here.
        drives: one per joint.
    """
    rows = {name: i for i, name in enumerate(plant.output_labels)}
    A_p, B_p = runge_kutta_step(plant.A, plant.B, stepping.tick, stepping.substeps)
    # states: plant, drives, theta_m, and the tau_load that the plant has published
    n_p, n_d = len(A_p), [len(drive.A) for drive in drives]
    start = n_p + np.concatenate([[0], np.cumsum(n_d)]).astype(int)
    angle, load = start[3] + np.arange(3), start[3] + 3 + np.arange(3)
    n = int(start[3]) + 6
    A, B = np.zeros((n, n)), np.zeros((n, 3))
    for i, drive in enumerate(drives):
        own = slice(start[i], start[i + 1])
        A[own, own], A[own, load[i]], B[own, i] = drive.A, drive.B[:, 1], drive.B[:, 0]
        A[angle[i], own], A[angle[i], load[i]], B[angle[i], i] = drive.C[0], drive.D[0, 1], drive.D[0, 0]
        A[angle[i], angle[i]] = 1.0
    seen, seen_of_command = (np.eye(n)[angle], np.zeros((3, 3))) if stepping.jacobi else (A[angle], B[angle])
    A[:n_p], B[:n_p] = B_p @ seen, B_p @ seen_of_command
    A[:n_p, :n_p] += A_p
    torque = [rows[name] for name in LOADS]
    A[load] = plant.C[torque] @ A[:n_p] + plant.D[torque] @ seen
    B[load] = plant.C[torque] @ B[:n_p] + plant.D[torque] @ seen_of_command
    C = np.zeros((len(MEASURED) + len(TRUE), n))
    C[range(3), angle] = 1.0
    C[3:, :n_p] = plant.C[[rows[name] for name in (*MEASURED[3:], *TRUE)]]
    return control.ss(
        A, B, C, np.zeros((len(C), 3)), stepping.tick, inputs=list(COMMANDS), outputs=[*MEASURED, *TRUE], name="tick"
    )


def period_map(tick: control.StateSpace, stepping: Stepping) -> control.StateSpace:
    """The same from one call of the controller to the next: its command is held for the period, after the delay.

    A delay of q periods and r ticks means that the command of q + 1 periods ago is still on for the first r ticks.
    """
    q, r = divmod(stepping.delay, stepping.period)
    A, early, late = np.eye(tick.nstates), np.zeros_like(tick.B), np.zeros_like(tick.B)
    for k in range(stepping.period):
        A, early, late = tick.A @ A, tick.A @ early, tick.A @ late
        if k < r:
            early = early + tick.B
        else:
            late = late + tick.B
    n, kept = tick.nstates, q + (1 if r else 0)
    # states: those of the tick, then the commands of 1, 2 .. periods ago
    A_, B_ = np.zeros((n + 3 * kept, n + 3 * kept)), np.zeros((n + 3 * kept, 3))
    A_[:n, :n] = A
    A_[n + 3 :, n:-3] = np.eye(3 * max(0, kept - 1))
    for age, share in ((q, late), (q + 1, early)):
        if age == 0:
            B_[:n] += share
        elif age <= kept:
            A_[:n, n + 3 * (age - 1) : n + 3 * age] += share
    if kept:
        B_[n : n + 3] = np.eye(3)
    C = np.hstack([tick.C, np.zeros((len(tick.C), 3 * kept))])
    T = stepping.period * stepping.tick
    return control.ss(A_, B_, C, tick.D, T, inputs=list(COMMANDS), outputs=tick.output_labels, name="robot")
