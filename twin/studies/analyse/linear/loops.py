"""Robot and controller as one sampled system, whose loops can be opened one at a time."""

from collections.abc import Mapping
from typing import TypeAlias

import control
import numpy as np
from numpy.typing import NDArray

from twin.studies.analyse.linear.drive_model import Matrix
from twin.studies.analyse.linear.sampled_law import ESTIMATED, LOOPS, REFERENCES, LinearLaw
from twin.studies.analyse.linear.sampled_robot import COMMANDS, MEASURED

Loops: TypeAlias = control.StateSpace
"""All loops of the robot, open, as `open_loops` names their inputs and outputs."""


def open_loops(robot: control.StateSpace, law: LinearLaw, whole: bool = False) -> Loops:
    """All loops open: inputs `LOOPS`, `REFERENCES`, `COMMANDS`; outputs `LOOPS`, `ESTIMATED`, `COMMANDS` and the truth.

    What comes in at one of `COMMANDS` is added to what the law commands, behind the output of that name.

    Args:
        robot: `period_map`, of which no output depends directly on an input.
        law: with the same period.
        whole: keep the states that no input reaches or no output sees, those of `robot` first.
    """
    angles = len(MEASURED)
    C_m, C_true = robot.C[:angles], robot.C[angles:]
    omega, rest = slice(0, 3), slice(3, None)
    A = np.block(
        [
            [robot.A + robot.B @ law.D[omega, :angles] @ C_m, robot.B @ law.C[omega]],
            [law.B[:, :angles] @ C_m, law.A],
        ]
    )
    at_the_law = np.vstack([robot.B @ law.D[omega, angles:], law.B[:, angles:]])
    at_the_drives = np.vstack([robot.B, np.zeros((len(law.A), len(COMMANDS)))])
    B = np.hstack([at_the_law, at_the_drives])
    C = np.vstack(
        [
            np.hstack([law.D[rest, :angles] @ C_m, law.C[rest]]),
            np.hstack([law.D[omega, :angles] @ C_m, law.C[omega]]),
            np.hstack([C_true, np.zeros((len(C_true), len(law.A)))]),
        ]
    )
    D = np.zeros((len(C), B.shape[1]))
    D[: len(law.D), : at_the_law.shape[1]] = np.vstack([law.D[rest, angles:], law.D[omega, angles:]])
    outputs = [*LOOPS, *ESTIMATED, *COMMANDS, *robot.output_labels[angles:]]
    kept = np.arange(len(A)) if whole else connected(A, B, C)
    A, B, C = A[np.ix_(kept, kept)], B[kept], C[:, kept]
    return control.ss(A, B, C, D, robot.dt, inputs=[*LOOPS, *REFERENCES, *COMMANDS], outputs=outputs, name="loops")


def connected(A: Matrix, B: Matrix, C: Matrix) -> NDArray[np.int64]:
    """Indices of the states that an input can reach and an output can see.

    Others are at rest for ever, like the integral of a loop with ki = 0 or the bristle of a surface that is not
    touched, and each of them would be a pole at z = 1.
    """
    linked = A != 0.0
    reached, seen = np.any(B != 0.0, axis=1), np.any(C != 0.0, axis=0)
    for _ in range(len(A)):
        reached, seen = reached | (linked @ reached), seen | (seen @ linked)
    return np.flatnonzero(reached & seen)


def closed_loops(loops: Loops, gains: Mapping[str, float]) -> Loops:
    """`loops` with some of `LOOPS` closed, each with a gain that multiplies all gains of its law; 1: as it is.

    Inputs and outputs stay: what comes in at a closed loop is added there.
    """
    n = len(LOOPS)
    K = np.diag([gains.get(name, 0.0) for name in LOOPS])
    # a = K b + what is added, b = C_b x + D_b a: solvable because no loop depends directly on itself
    share = np.linalg.inv(np.eye(n) - K @ loops.D[:n, :n])
    back, added = share @ K @ loops.C[:n], np.zeros((n, loops.ninputs))
    added[:, :n] = share
    added[:, n:] = share @ K @ loops.D[:n, n:]
    B_a, D_a = loops.B[:, :n], loops.D[:, :n]
    B, D = B_a @ added, D_a @ added
    B[:, n:] += loops.B[:, n:]
    D[:, n:] += loops.D[:, n:]
    A, C = loops.A + B_a @ back, loops.C + D_a @ back
    return control.ss(A, B, C, D, loops.dt, inputs=loops.input_labels, outputs=loops.output_labels)


def spectral_radius(loops: Loops, gains: Mapping[str, float]) -> float:
    """Largest magnitude of a pole with the loops closed; below 1: stable."""
    return float(np.abs(closed_poles(loops, gains)).max())


def closed_poles(loops: Loops, gains: Mapping[str, float]) -> NDArray[np.complex128]:
    """Poles in z with the loops closed (n,)."""
    n = len(LOOPS)
    K = np.diag([gains.get(name, 0.0) for name in LOOPS])
    back = np.linalg.solve(np.eye(n) - K @ loops.D[:n, :n], K @ loops.C[:n])
    return np.linalg.eigvals(loops.A + loops.B[:, :n] @ back).astype(complex)
