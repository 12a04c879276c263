"""Recordings of tasks as they are meant to be, written by hand, with a flaw where a test wants one."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.recording.messages import Field, Topic
from twin.kernel.recording.reader import Recording, read
from twin.kernel.recording.writer import Writer
from twin.robot.controller.program import PhaseKind

TICK = 1e-3
SURFACE = -0.101
TABLES: dict[str, dict[str, Any]] = {
    "press": {"force_N": 8.0, "build_up_s": 2.0, "hold_s": 2.0},
    "tap": {"force_N": 3.0, "speed_mm_per_s": 100.0, "lift_mm": 8.0, "period_s": 0.5, "times": 4},
    "roll": {"force_N": 5.0, "build_up_s": 2.0, "radius_mm": 5.0, "rate_Hz": 2.0, "turns": 3.0},
    "push": {"force_N": 5.0, "build_up_s": 2.0, "to_mm": [4.0, 3.0], "speed_mm_per_s": 5.0},
}
PLANT = Topic(
    "plant",
    (Field("p_B", 3, "double", "m", ""), Field("v_B", 3, "double", "m/s", ""), Field("F_ee_B", 3, "double", "N", "")),
    1,
)
CONTROLLER = Topic(
    "controller",
    (
        Field("p_ref_B", 3, "double", "m", ""), Field("p_cmd_B", 3, "double", "m", ""),
        Field("F_z", 1, "double", "N", ""), Field("F_z_ref", 1, "double", "N", ""),
        Field("task", 1, "int", "1", ""), Field("phase", 1, "int", "1", ""),
    ),
    2,
)  # fmt: skip
MONITOR = Topic("monitor", (Field("tripped", 1, "bool", "1", ""), Field("reason", 1, "int", "1", "")), 2)


def written(
    folder: Path, kind: str, phases: list[tuple[PhaseKind, float]], F_z: np.ndarray, p_B: np.ndarray, trip: float
) -> Recording:
    """One task of `kind` as a recording.

    Args:
        phases: what is done for how long (s). F_z: (n,). p_B: (n, 3). trip: when the monitor trips (s).
    """
    n = len(F_z)
    phase = np.concatenate([np.full(round(time / TICK), int(what)) for what, time in phases])[:n]
    v_B = np.gradient(p_B, TICK, axis=0)
    F_ee_B = np.outer(F_z, [0.0, 0.0, -1.0])
    task = {"kind": kind, "point_mm": [0.0, 0.0], **TABLES[kind]}
    settings = {
        "task": [task], "contact": {"kind": "scale", "height_mm": 1e3 * SURFACE},
        "drive": {"fmu": "velocity_servo"}, "monitor": {},
    }  # fmt: skip
    tripped = TICK * np.arange(n) >= trip
    rows = {
        PLANT: np.column_stack([p_B, v_B, F_ee_B]),
        CONTROLLER: np.column_stack([p_B, p_B, F_z, np.full(n, TABLES[kind]["force_N"]), np.ones(n), phase])[::2],
        MONITOR: np.column_stack([tripped, 8 * tripped])[::2],
    }
    path = folder / "run.mcap"
    with Writer(path, list(rows), TICK, {"experiment": {"values": json.dumps(settings)}}) as writer:
        for topic, values in rows.items():
            writer.write(topic.name, 0, values)
        writer.finish()
    return read(path)


def under_force(
    folder: Path,
    kind: str,
    work: PhaseKind,
    duration: float,
    path: np.ndarray | None = None,
    force: np.ndarray | float = 0.0,
    descent: float = 0.010,
    rise: float = 2.0,
    trip: float = np.inf,
) -> Recording:
    """A task that presses: down, build-up, work, release.

    Args:
        duration: of the work (s). path: (n, 2) x and y during the work (m). force: added to the reference there (N).
        descent: speed at the touch (m/s). rise: time in which the force gets there (s).
    """
    F_ref = TABLES[kind]["force_N"]
    t_down, t_up, t_work = (TICK * np.arange(round(time / TICK)) for time in (0.5, 2.0, duration))
    x = np.clip(t_up / rise, 0.0, 1.0)
    F_work = np.broadcast_to(F_ref + force, t_work.shape)
    F_z = np.concatenate([np.where(t_down > 0.49, 0.1, 0.0), F_ref * x * x * (3.0 - 2.0 * x), F_work, np.zeros(500)])
    p_B = np.zeros((len(F_z), 3))
    p_B[:, 2] = SURFACE
    p_B[: len(t_down), 2] += descent * (0.5 - t_down)
    if path is not None:
        p_B[2500 : 2500 + len(t_work), :2] = path
    phases = [(PhaseKind.DESCEND, 0.5), (PhaseKind.BUILD_UP, 2.0), (work, duration), (PhaseKind.RETRACT, 0.5)]
    return written(folder, kind, phases, F_z, p_B, trip)


def pressed(folder: Path, aside: float = 0.0, **flaws) -> Recording:
    """2 s on the point, or `aside` (m)."""
    # 1 um beside the point: exactly on it, the robot's symmetry would make the claim trivial
    path = np.full((2000, 2), (1e-6 + aside, 0.0))
    return under_force(folder, "press", PhaseKind.HOLD, 2.0, path, **flaws)


def rolled(
    folder: Path, radius: float = 0.005, centre: float = 0.0, wave: float = 0.0, turns: float = 5.0, **flaws
) -> Recording:
    """Circles at 2 Hz for 2.5 s, of which the first and the last half second lead in and out.

    Args:
        radius: m. centre: x of it (m). wave: share of the radius by which it is not round. turns: that are done.
    """
    angle = 2.0 * np.pi * turns * np.linspace(0.0, 1.0, 2500, endpoint=False)
    r = radius * (1.0 + wave * np.sqrt(2.0) * np.cos(4.0 * angle))
    path = np.column_stack([centre + r * np.cos(angle), r * np.sin(angle)])
    return under_force(folder, "roll", PhaseKind.CIRCLE, 2.5, path, **flaws)


def pushed(folder: Path, off: float = 1e-6, bulge: float = 0.0, share: float = 1.0, **flaws) -> Recording:
    """From (0, 0) to (4, 3) mm within 1 s.

    Args:
        off: rms distance from the line (m). bulge: m, added in the middle for a moment. share: of the line.
    """
    s = np.linspace(0.0, share, 1000)
    aside = off * np.where(np.arange(1000) % 2, 1.0, -1.0) + bulge * (np.abs(s - 0.5) < 0.01)
    path = np.column_stack([0.004 * s - 0.6 * aside, 0.003 * s + 0.8 * aside])
    return under_force(folder, "push", PhaseKind.PUSH, 1.0, path, **flaws)


def tapped(
    folder: Path,
    peaks: tuple[float, ...] = (2.9, 3.0, 3.1, 3.0),
    period: float = 0.5,
    speed: float = 0.1,
    rest: float = 0.0,
    above: float = 0.01,
    aside: float = 0.0,
    trip: float = np.inf,
) -> Recording:
    """A tap of 50 ms for each of `peaks` (N).

    Args:
        period: of the third tap after the second (s), 0.5 of all others. speed: at the touch (m/s).
        rest: force that is left after a tap (N). above: height from which a tap goes down (m). aside: x (m).
    """
    phases, F_z, z = [], [], []
    for number, peak in enumerate(peaks):
        time = period if number == 1 else 0.5
        t = TICK * np.arange(round(time / TICK))
        touch = (t >= 0.1) & (t < 0.15)
        F_z.append(np.where(touch, peak * np.sin(np.pi * (t - 0.0995) / 0.05), np.where(t < 0.1, 0.0, rest)))
        z.append(SURFACE + np.where(t < 0.12, np.minimum(speed * (0.1 - t), above), above))
        phases += [(PhaseKind.TAP, 0.12), (PhaseKind.RISE, 0.1), (PhaseKind.WAIT, time - 0.22)]
    F_all = np.concatenate(F_z)
    p_B = np.column_stack([np.full_like(F_all, aside), np.zeros_like(F_all), np.concatenate(z)])
    return written(folder, "tap", phases, F_all, p_B, trip)
