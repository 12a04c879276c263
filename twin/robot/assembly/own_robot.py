"""Files of a robot of one's own: lengths and masses given, heights and limits computed, the rest inherited.

The home pose (`mechanism.workspace.home_height`) decides the height at which the robot works, as Fig. 4 does for the
paper's robot: there the platform presses, `PRESS_DEPTH` below the surface. All distances from the surface are those of
the shipped experiments, times a share for robots with less space.
"""

import contextlib
import math
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_toml
from twin.kernel.units import parse_float
from twin.robot.assembly.build import monitor_belief
from twin.robot.assembly.checks.monitor_limits import contradictions, raised_limits
from twin.robot.assembly.checks.reach import find_obstruction, free_poses
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.load import checked_experiment, load_experiment
from twin.robot.experiment.drive_files import locate_drive
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.experiment_files import experiment_file
from twin.robot.experiment.mistakes import MAX_LENGTH, MIN_LENGTH, check_table
from twin.robot.experiment.robot_file import fit_to_robot
from twin.robot.experiment.source import ROBOT_TABLES, Source, apply_overrides, is_robot, read_source, toml_value
from twin.robot.experiment.template import (
    FIG4_EXPERIMENT,
    ROBOT_FILE,
    TASK_EXPERIMENT,
    commented_experiment,
    commented_robot,
    shipped_experiment,
    start_experiment,
    write_new,
)
from twin.robot.mechanism.geometry import OUTWARD, geometry_of
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.mechanism.statics import Masses, leg_inertia, moving_mass, platform_stiffness
from twin.robot.mechanism.unreachable import Unreachable
from twin.robot.mechanism.workspace import HOME_ANGLE, home_height
from twin.robot.monitor.limits import Monitor
from twin.robot.paths import locate_file
from twin.robot.plant.dynamics import Robot

GIVEN_VALUES = {
    "--lengths-mm": (("a", "b", "l_a", "l_b"), MIN_LENGTH, MAX_LENGTH),
    "--masses-g": (("m_a", "m_b", "m_p"), 1e-3, 1e5),
}
"""Option -> names of its values, their minimum and maximum."""
PRESS_DEPTH = 4.0
"""Depth (mm) of the home pose below the surface: Fig. 4 presses at p_z = -105 mm on a surface at -101 mm."""
APPROACH_HEIGHT, FLOOR_DEPTH = 9.0, 29.0
"""Height of travel above the surface and depth of the deepest search for contact (mm), as in massage.toml."""
SPACE = {"workspace_radius_mm": 40.0, "z_min_mm": -34.0, "z_max_mm": 26.0}
"""Defaults of [monitor] on the shipped robot (mm); heights above the surface."""
RANGE_RINGS = 20
"""Number of rings that fill the monitor's cylinder for the ranges of the encoders, exact to 0.05 deg."""
MIN_FREQUENCY = 6.0
"""Natural frequency (Hz) below which tasks are doubtful: they trip the monitor below 5 Hz, and hold from 8.7 Hz on."""
SWING_NOTE = (
    f"a natural frequency below {MIN_FREQUENCY:g} Hz: with the shipped gains the platform may swing until the monitor "
    "trips; choose stiffer springs or a lighter robot, or twin tune"
)
SPACE_SHARES = tuple(round(1.0 - 0.05 * step, 2) for step in range(15))
"""Shares of that space that are tried, the largest first; with less there is no room for a massage."""


def cylinder_poses(radius: float, bottom: float, top: float, rings: int = 2) -> NDArray[np.float64]:
    """Return platform poses (n, 3) that fill a vertical cylinder about the axis with concentric rings, SI."""
    angles, radii = np.radians(np.arange(0.0, 360.0, 5.0)), radius * np.arange(1.0, rings + 1.0)[:, None] / rings
    x, y, z = np.broadcast_arrays(
        radii * np.cos(angles), radii * np.sin(angles),
        np.linspace(bottom, top, 13)[:, None, None],
    )  # fmt: skip
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def natural_frequency(robot: Robot, p_B: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the natural frequencies (Hz) of a robot on its springs at `p_B` (3,), m, along x, y and z, (3,).

    Along e: sqrt(stiffness / M_ee) / (2 pi), with `plant.dynamics`
    M_ee = m_p + m_b + I_a sum_i J_ie^2 + m_b/3 sum_i d_ie J_ie.
    """
    geometry, masses = geometry_of(robot), Masses(robot.m_a, robot.m_b, robot.m_p, robot.I_r)
    J, theta_l = jacobian(geometry, p_B), joint_angles(geometry, p_B)
    sine, cosine = np.sin(theta_l)[:, None], np.cos(theta_l)[:, None]
    d = geometry.l_a * (-sine * OUTWARD - cosine * np.array([0.0, 0.0, 1.0]))
    mass = moving_mass(masses) + np.sum(leg_inertia(geometry, masses) * J**2 + robot.m_b / 3.0 * d * J, axis=0)
    stiffness = platform_stiffness(J, robot.k_s * robot.N**2 * robot.eta)
    return np.asarray(np.sqrt(stiffness / mass) / (2.0 * math.pi), dtype=np.float64)


def swing_notes(frequency: NDArray[np.float64]) -> list[str]:
    """Return the note on a robot with too low a natural frequency (3,), Hz; empty for others."""
    return [SWING_NOTE] if frequency.min() < MIN_FREQUENCY else []


def working_space(robot: Robot) -> tuple[float, dict[str, tuple[float, str]], Monitor]:
    """Compute the place at which a robot works.

    Returns:
        (z of the home pose (mm), computed values of its file by dotted key, with sources, its monitor).

    Raises:
        InputRefused: the robot has no home pose, or too little space around it.
    """
    home = 1e3 * home_height(geometry_of(robot))
    if found := find_obstruction(robot, np.array([[0.0, 0.0, 1e-3 * home]])):
        reason = found[1].partition("; ")[0]
        raise InputRefused(f"no home pose: {reason}; change the lengths, or --set the key of [robot]")
    surface, belief, problem = float(round(home + PRESS_DEPTH)), monitor_belief(robot), ""
    for share in SPACE_SHARES:
        limits = {key: round(share * d + surface * key.startswith("z"), 1) for key, d in SPACE.items()}
        if limits["z_max_mm"] >= 0.0:
            problem = "it is too near the base"
            continue
        raised: dict[str, float] = {}
        with contextlib.suppress(Unreachable):
            # contradictions report a pose that is out of reach
            raised = raised_limits(Monitor(**limits), belief)
        monitor = Monitor(**limits | raised)
        problems = contradictions(monitor, belief, monitor.period, math.inf)
        poses = cylinder_poses(monitor.workspace_radius, monitor.z_min, monitor.z_max)
        if not problems and free_poses(robot, poses).all():
            break
        problem = problems[0] if problems else "links or rods would touch, or a ball joint bend too far"
    else:
        raise InputRefused(
            f"no room to work at the home pose (0, 0, {home:.1f}) mm; change lengths or masses, or --set "
            f"robot.k_s_Nm_per_rad: {problem}"
        )
    above, below = min(APPROACH_HEIGHT, 0.8 * share * SPACE["z_max_mm"]), share * FLOOR_DEPTH
    less = "" if share == 1.0 else f", {share:g} of the shipped robot's space: more is not free"
    computed = {
        "contact.height_mm": (surface, f"{PRESS_DEPTH:g} mm above the home pose (0, 0, {home:.1f}) mm"),
        "approach.height_mm": (round(surface + above, 1), "above the surface"),
        "approach.floor_mm": (round(surface - below, 1), f"below the surface{less}"),
        **{f"monitor.{key}": (value, f"about the surface, within reach{less}") for key, value in limits.items()},
        **{f"monitor.{key}": (value, "encoders and springs allow no less") for key, value in raised.items()},
    }
    return home, {key: (value, f"computed: {why}") for key, (value, why) in computed.items()}, monitor


def start_robot(
    file: Path, lengths: Iterable[str], masses: Iterable[str] = (), settings: Iterable[str] = ()
) -> list[Path]:
    """Write the file of a new robot; return the written files, see `write_new`.

    Args:
        lengths, masses: `name=number` of all lengths (mm), and of some masses (g), see `GIVEN_VALUES`.
        settings: other values of [robot], `robot.key=value`.

    Raises:
        InputRefused: `file` exists, a value is invalid, or the robot cannot work.
        NotWritten: the file cannot be written.
    """
    own = Source({"robot": {"name": file.stem}})
    apply_overrides(own, settings)
    decided = {f"{name}_{option.rpartition('-')[2]}" for option, (names, *_) in GIVEN_VALUES.items() for name in names}
    values = own.values.pop("robot")
    if own.values or not isinstance(values, dict) or values.keys() & decided:
        raise InputRefused("--set: expected other values of [robot] than lengths and masses, as robot.k_s_Nm_per_rad=2")
    own.values["robot"] = values
    for (option, (names, least, most)), texts in zip(GIVEN_VALUES.items(), (lengths, masses), strict=True):
        unit = option.rpartition("-")[2]
        for text in texts:
            name, _, value = text.partition("=")
            key = f"{name}_{unit}"
            if name not in names or key in own.values["robot"]:
                raise InputRefused(f"{option} {text}: unknown or given twice; expected each of {', '.join(names)} once")
            number = parse_float(value)
            if number is None or not least <= number <= most:
                raise InputRefused(f"{option} {text}: expected a number of {unit} from {least:g} to {most:g}")
            own.merge({"robot": {key: number}}, f"given: {option}")
    if missing := [name for name in GIVEN_VALUES["--lengths-mm"][0] if f"{name}_mm" not in own.values["robot"]]:
        raise InputRefused(f"--lengths-mm: {', '.join(missing)} is missing; expected a=80 b=35 l_a=100 l_b=180, in mm")
    shipped = read_source(locate_file(f"experiments/{ROBOT_FILE}", Path.cwd())).values
    mistakes: list[str] = []
    robot = check_table(Robot, {**shipped["robot"], **own.values["robot"]}, "robot", mistakes)
    if robot is None:
        raise InputRefused(mistakes[0])
    home, computed, monitor = working_space(robot)
    massage = read_source(shipped_experiment(TASK_EXPERIMENT))
    own.values["approach"] = dict(massage.values["approach"])
    own.origins |= {key: text for key, text in massage.origins.items() if key.startswith("approach.")}
    for dotted, (height, source) in computed.items():
        table, _, key = dotted.partition(".")
        own.merge({table: {key: height}}, source)
    text = commented_robot(DECLARED_TABLES, file.name, own, [*_remarks(robot, home, monitor, own)])
    return write_new(DECLARED_TABLES, file, text)


def _remarks(robot: Robot, home: float, monitor: Monitor, own: Source) -> Iterable[str]:
    """Yield the consequences of a robot's lengths that are no keys of its file."""
    yield "Computed from the lengths, for reading:"
    yield f"home pose: p = (0, 0, {home:.1f}) mm, proximal links {math.degrees(HOME_ANGLE):g} deg below the horizontal"
    # the smallest joint angle may be inside the cylinder
    poses = cylinder_poses(monitor.workspace_radius, monitor.z_min, monitor.z_max, RANGE_RINGS)
    theta_l, bent = joint_angles(geometry_of(robot), poses), monitor.deflection_limit
    for name, counts, ends in (
        ("joint", robot.joint_counts_per_turn, (theta_l.min(), theta_l.max())),
        ("motor", robot.motor_counts_per_turn, (robot.N * theta_l.min() - bent, robot.N * theta_l.max() + bent)),
    ):
        degrees = " to ".join(f"{math.degrees(end):.1f}" for end in ends)
        numbers = " to ".join(str(round(end / (2.0 * math.pi) * counts)) for end in ends)
        yield f"range of the {name} encoders within [monitor]: {degrees} deg, counts {numbers} of {counts} per turn"
    fig4 = read_source(shipped_experiment(FIG4_EXPERIMENT))
    fit_to_robot(fig4, read_source(shipped_experiment(FIG4_EXPERIMENT)), own)
    yield "way points of Fig. 4 on this robot (mm), as twin init writes them into its experiments:"
    yield f"p_mm = {toml_value(fig4.values['reference']['p_mm'])}"


def experiment_on_robot(robot: Path, start: str, overrides: Iterable[str] = (), drive: str | None = None) -> Experiment:
    """Return the shipped experiment `start` on the robot of a file, by the name of the file.

    Raises:
        InputRefused: the robot cannot do the experiment, or a file is invalid.
    """
    for name, table in read_source(robot).values.items():
        if name in ROBOT_TABLES and not isinstance(table, dict):
            raise InputRefused(f"{robot}: [{name}] = {table!r}: expected a table")
    text = commented_experiment(DECLARED_TABLES, robot.name, shipped_experiment(start), robot, ROBOT_FILE)
    tables = dict(parse_toml(text, str(robot)))
    del tables["extends"]
    source, folder = read_source(robot), robot.resolve().parent
    source.overlay(tables, f"set in {robot.name}")
    if drive is not None:
        source.select_file("drive", "fmu", locate_drive(drive, folder))
    apply_overrides(source, overrides)
    return _require_masses(checked_experiment(source, robot.stem, robot, folder), robot)


def load_on_robot(path: Path, overrides: Iterable[str] = (), drive: str | None = None) -> Experiment:
    """Load an experiment, or Fig. 4 on the robot if the file is a robot's; see `load_experiment`."""
    file = experiment_file(path)
    if is_robot(read_source(file).values):
        return experiment_on_robot(file, FIG4_EXPERIMENT, overrides, drive)
    return _require_masses(load_experiment(path, overrides, drive), path)


def _require_masses(experiment: Experiment, file: Path) -> Experiment:
    """Return an experiment whose robot has mass in all parts; a plant alone may idealise them as massless."""
    for name in GIVEN_VALUES["--masses-g"][0]:
        if getattr(experiment.plant, name) == 0.0:
            raise InputRefused(f"{file}: [robot] {name}_g = 0: expected a mass > 0 g")
    return experiment


def robot_notes(experiment: Experiment) -> list[str]:
    """Return notes on the robot of an experiment at its working height."""
    return swing_notes(natural_frequency(experiment.plant, np.array([0.0, 0.0, experiment.contact.height])))


def start_on_robot(file: Path, start: str, robot: Path) -> tuple[list[Path], Experiment]:
    """Write a shipped experiment on another robot like `start_experiment`, if the robot can do it; return both."""
    if not os.path.isfile(robot):
        raise InputRefused(f"{robot}: no such robot file; --lengths-mm a=80 b=35 l_a=100 l_b=180 writes one")
    experiment = experiment_on_robot(robot, start)
    return start_experiment(DECLARED_TABLES, file, start, robot), experiment
