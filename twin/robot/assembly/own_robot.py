"""Files of a robot of one's own: lengths and masses given, heights and limits computed, the rest inherited.

The home pose (`mechanism.workspace.home_height`) decides the height at which the robot works, as Fig. 4 does for the
paper's robot: there the platform presses, `PRESS_DEPTH` below the surface. All distances from the surface are those of
the shipped experiments, times a share for robots that are too small for them.
"""

import contextlib
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import parse_toml
from twin.robot.assembly.build import monitor_belief
from twin.robot.assembly.checks.monitor_limits import contradictions, derived_limits
from twin.robot.assembly.checks.reach import find_obstruction, free_poses
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.load import checked_experiment, load_experiment
from twin.robot.experiment.drive_files import locate_drive
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.experiment_files import experiment_file
from twin.robot.experiment.mistakes import MAX_LENGTH, MIN_LENGTH, check_table
from twin.robot.experiment.robot_file import SHIPPED_RADIUS, SHIPPED_SURFACE, fit_to_robot
from twin.robot.experiment.source import Source, apply_overrides, is_robot, read_source, toml_value
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
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.mechanism.workspace import home_height
from twin.robot.monitor.limits import Monitor
from twin.robot.paths import locate_file
from twin.robot.plant.dynamics import Robot

LENGTHS, MASSES = ("a", "b", "l_a", "l_b"), ("m_a", "m_b", "m_p")
PRESS_DEPTH = 4.0
"""Depth (mm) of the home pose below the surface: Fig. 4 presses at p_z = -105 mm on a surface at -101 mm."""
APPROACH_HEIGHT, FLOOR_DEPTH = 9.0, 29.0
"""Height of travel above the surface and depth of the deepest search for contact (mm), as in massage.toml."""
TOP_HEIGHT, BOTTOM_DEPTH = 26.0, 34.0
"""Height above and depth below the surface of the monitor's z_max and z_min (mm), its defaults on the shipped robot."""
SPACE_SHARES = tuple(round(1.0 - 0.05 * step, 2) for step in range(15))
"""Shares of the shipped workspace that are tried, the largest first; with less there is no room for a massage."""
TASK_SPACE = 0.8
"""Maximum height of travel as a share of the monitor's z_max above the surface."""
MIN_MASS, MAX_MASS = 1e-3, 1e5
"""Range of masses (g)."""


def given_numbers(
    option: str, texts: Iterable[str], names: Sequence[str], least: float, most: float
) -> dict[str, float]:
    """Parse `name=number` texts of an option whose numbers are from `least` to `most`.

    Raises:
        InputRefused: a name is unknown or repeated, or a number is invalid.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in names:
            raise InputRefused(f"{option} {text}: no such value; {nearest(name, names, 'expected {}')}")
        if name in found:
            raise InputRefused(f"{option} {text}: {name} is given twice")
        with contextlib.suppress(ValueError):
            found[name] = float(value)
        if not least <= found.get(name, math.nan) <= most:
            unit = option.rpartition("-")[2]
            raise InputRefused(f"{option} {text}: expected a number of {unit} from {least:g} to {most:g}")
    return found


def cylinder_poses(radius: float, bottom: float, top: float) -> NDArray[np.float64]:
    """Return platform poses (n, 3) that fill a vertical cylinder about the axis, SI."""
    angles, shares = np.radians(np.arange(0.0, 360.0, 5.0)), np.array([1.0, 0.5])
    disk = [(share * radius * np.cos(angles), share * radius * np.sin(angles)) for share in shares]
    x, y = np.append(np.ravel([x for x, _ in disk]), 0.0), np.append(np.ravel([y for _, y in disk]), 0.0)
    heights = np.linspace(bottom, top, 13)
    return np.column_stack([np.tile(x, len(heights)), np.tile(y, len(heights)), np.repeat(heights, len(x))])


class WorkingSpace(NamedTuple):
    """Place at which a robot works, from its lengths (mm).

    Attributes:
        home: z of the home pose.
        surface: z of the surface.
        share: share of the shipped workspace.
        limits: keys of [monitor] -> (value, source).
        monitor: these limits as a table.
    """

    home: float
    surface: float
    share: float
    limits: dict[str, tuple[float, str]]
    monitor: Monitor

    def from_surface(self, distance: float) -> float:
        """Return the z (mm) of a height above the surface on the shipped robot (mm)."""
        return round(self.surface + self.share * distance, 1)


def working_space(robot: Robot) -> WorkingSpace:
    """Compute the place at which a robot works.

    Raises:
        InputRefused: the robot has no home pose, or too little space around it.
    """
    home = 1e3 * home_height(geometry_of(robot))
    at_home = np.array([[0.0, 0.0, 1e-3 * home]])
    if found := find_obstruction(robot, at_home):
        raise InputRefused(f"no home pose: {found[1]}")
    problem = ""
    for share in SPACE_SHARES:
        space = WorkingSpace(home, float(round(home + PRESS_DEPTH)), share, {}, Monitor())
        space = _limited(space, robot)
        monitor = space.monitor
        problems = contradictions(monitor, monitor_belief(robot), monitor.period, math.inf)
        poses = cylinder_poses(monitor.workspace_radius, monitor.z_min, monitor.z_max)
        if not problems and free_poses(robot, poses).all():
            return space
        problem = problems[0] if problems else "links or rods would touch, or a ball joint bend too far"
    raise InputRefused(
        f"no room to work at the home pose (0, 0, {home:.1f}) mm, not even {SPACE_SHARES[-1] * SHIPPED_RADIUS:g} mm "
        f"about the axis; change lengths or masses, or --set robot.k_s_Nm_per_rad: {problem}"
    )


def _limited(space: WorkingSpace, robot: Robot) -> WorkingSpace:
    """Return the working space with the limits of its monitor."""
    radius, top, bottom = (
        f"{distance:g} mm" + ("" if space.share == 1.0 else f" times {space.share:g}, more is not free")
        for distance in (SHIPPED_RADIUS, TOP_HEIGHT, BOTTOM_DEPTH)
    )
    limits = {
        "workspace_radius_mm": (round(space.share * SHIPPED_RADIUS, 1), f"computed: {radius}, within reach"),
        "z_min_mm": (space.from_surface(-BOTTOM_DEPTH), f"computed: below the surface by {bottom}"),
        "z_max_mm": (space.from_surface(TOP_HEIGHT), f"computed: over the surface by {top}"),
    }
    with_limits = space._replace(limits=limits, monitor=_monitor(limits))
    try:
        limits |= derived_limits(with_limits.monitor, monitor_belief(robot))
    except InputRefused:
        # contradictions report the pose that is out of reach
        return with_limits
    return with_limits._replace(limits=limits, monitor=_monitor(limits))


def _monitor(limits: dict[str, tuple[float, str]]) -> Monitor:
    return Monitor(**{key: value for key, (value, _) in limits.items()})


def start_robot(
    file: Path, lengths: Iterable[str], masses: Iterable[str] = (), settings: Iterable[str] = ()
) -> list[Path]:
    """Write the file of a new robot.

    Args:
        file: file to write.
        lengths: `name=mm` of all of `LENGTHS`.
        masses: `name=g` of some of `MASSES`.
        settings: other values of [robot], `robot.key=value`.

    Returns:
        The written files: `file`, and the JSON Schema beside it if missing.

    Raises:
        InputRefused: `file` exists, a value is invalid, or the robot cannot work.
        NotWritten: the file cannot be written.
    """
    given = given_numbers("--lengths-mm", lengths, LENGTHS, MIN_LENGTH, MAX_LENGTH)
    if missing := [name for name in LENGTHS if name not in given]:
        raise InputRefused(f"--lengths-mm: {', '.join(missing)} is missing; expected a=80 b=35 l_a=100 l_b=180, in mm")
    weights = given_numbers("--masses-g", masses, MASSES, MIN_MASS, MAX_MASS)
    own = Source()
    apply_overrides(own, settings)
    if own.values.keys() - {"robot"}:
        raise InputRefused("--set: only values of [robot] describe a robot, such as robot.k_s_Nm_per_rad=2")
    own.merge({"robot": {f"{name}_mm": value for name, value in given.items()}}, "given: --lengths-mm")
    own.merge({"robot": {f"{name}_g": value for name, value in weights.items()}}, "given: --masses-g")
    shipped = read_source(locate_file(f"experiments/{ROBOT_FILE}", Path.cwd())).values
    mistakes: list[str] = []
    robot = check_table(Robot, {**shipped["robot"], **own.values["robot"]}, "robot", mistakes)
    if robot is None:
        raise InputRefused(mistakes[0])
    own.values["robot"].setdefault("name", file.stem)
    space = working_space(robot)
    height = round(min(APPROACH_HEIGHT, TASK_SPACE * space.share * TOP_HEIGHT), 1)
    floor = space.from_surface(-FLOOR_DEPTH)
    own.values["approach"] = dict(read_source(shipped_experiment(TASK_EXPERIMENT)).values["approach"])
    computed = {
        "contact.height_mm": (
            space.surface, f"computed: {PRESS_DEPTH:g} mm above the home pose (0, 0, {space.home:.1f}) mm"
        ),
        "approach.height_mm": (space.surface + height, f"computed: {height:g} mm over the surface"),
        "approach.floor_mm": (floor, f"computed: {space.surface - floor:g} mm below the surface"),
        **{f"monitor.{key}": value for key, value in space.limits.items()},
    }  # fmt: skip
    for dotted, (value, source) in computed.items():
        table, _, key = dotted.partition(".")
        own.merge({table: {key: value}}, source)
    return write_new(
        DECLARED_TABLES, file, commented_robot(DECLARED_TABLES, file.name, own, [*_remarks(robot, space, own)])
    )


def _remarks(robot: Robot, space: WorkingSpace, own: Source) -> Iterable[str]:
    """Yield the consequences of a robot's lengths that are no keys of its file."""
    yield "Computed from the lengths, for reading:"
    yield f"home pose: p = (0, 0, {space.home:.1f}) mm, all proximal links 20 deg below the horizontal"
    monitor = space.monitor
    poses = cylinder_poses(monitor.workspace_radius, monitor.z_min, monitor.z_max)
    theta_l = joint_angles(geometry_of(robot), poses)
    low, high = float(theta_l.min()), float(theta_l.max())
    bent = monitor.deflection_limit
    for name, counts, ends in (
        ("joint", robot.joint_counts_per_turn, (low, high)),
        ("motor", robot.motor_counts_per_turn, (robot.N * low - bent, robot.N * high + bent)),
    ):
        degrees = " to ".join(f"{math.degrees(end):.1f}" for end in ends)
        numbers = " to ".join(str(round(end / (2.0 * math.pi) * counts)) for end in ends)
        yield f"range of the {name} encoders within [monitor]: {degrees} deg, counts {numbers} of {counts} per turn"
    fig4 = read_source(shipped_experiment(FIG4_EXPERIMENT))
    fit_to_robot(fig4, Source({"contact": {"height_mm": SHIPPED_SURFACE}}), own)
    yield "way points of Fig. 4 on this robot (mm), as twin init writes them into its experiments:"
    yield f"p_mm = {toml_value(fig4.values['reference']['p_mm'])}"


def experiment_on_robot(
    robot: Path, start: str, where: Path, overrides: Iterable[str] = (), drive: str | None = None
) -> Experiment:
    """Return a shipped experiment on another robot, without writing a file.

    Args:
        robot: file of the robot.
        start: name of the experiment.
        where: file of the experiment, for its name and error messages.
        overrides, drive: as in `load_experiment`.

    Raises:
        InputRefused: the robot cannot do the experiment, or a file is invalid.
    """
    text = commented_experiment(DECLARED_TABLES, where.name, shipped_experiment(start), robot, ROBOT_FILE)
    tables = dict(parse_toml(text, str(where)))
    del tables["extends"]
    source, folder = read_source(robot), robot.resolve().parent
    source.overlay(tables, f"set in {where.name}")
    if drive is not None:
        source.select_file("drive", "fmu", locate_drive(drive, folder))
    apply_overrides(source, overrides)
    return checked_experiment(source, where.stem, where, folder)


def load_on_robot(path: Path, overrides: Iterable[str] = (), drive: str | None = None) -> Experiment:
    """Load an experiment, or Fig. 4 on the robot if the file is a robot's; see `load_experiment`.

    Raises:
        InputRefused: with one sentence per error.
    """
    file = experiment_file(path)
    if is_robot(read_source(file).values):
        return experiment_on_robot(file, FIG4_EXPERIMENT, file, overrides, drive)
    return load_experiment(path, overrides, drive)


def start_on_robot(file: Path, start: str, robot: Path) -> list[Path]:
    """Write a new experiment file: a shipped experiment on another robot, after a check that the robot can do it.

    Returns:
        The written files: `file`, and the JSON Schema beside it if missing.

    Raises:
        InputRefused: `file` exists, or the robot cannot do the experiment.
        NotWritten: the file cannot be written.
    """
    if not os.path.isfile(robot):
        raise InputRefused(f"{robot}: no such robot's file; --lengths-mm a=80 b=35 l_a=100 l_b=180 writes one")
    experiment_on_robot(robot, start, file)
    return start_experiment(DECLARED_TABLES, file, start, robot)
