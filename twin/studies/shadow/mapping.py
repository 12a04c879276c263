"""Signals of a column map that a twin follows, and readings from a log."""

import re
from collections.abc import Iterator, Mapping

import numpy as np

from twin.kernel.cosim.port import width
from twin.kernel.errors import nearest
from twin.kernel.recording.logs.column_map import TIME_SIGNAL, refuse_unit
from twin.kernel.recording.logs.log import Log, LogError, MappedColumn
from twin.kernel.recording.sources.arrival import Arrival
from twin.kernel.recording.sources.signals import Reading, WantedSignal
from twin.robot.controller.controller import Belief
from twin.studies.replay.plausible import ANGLE_OF_COUNT, FORCE_SIGNAL, count_conversion
from twin.studies.replay.sample_columns import COUNT_L, COUNT_M, ENCODERS, F_Z, INPUTS, OMEGA_REF, TAU
from twin.studies.replay.samples import hold_until_sampled, robot_samples

ENCODER_COLUMNS = range(ENCODERS.start, ENCODERS.stop)
NS_PER_SECOND = 1e9


def wanted_signals(belief: Belief) -> dict[str, WantedSignal]:
    """List the robot signals that a column map may name, with their columns and conversions."""
    found = {FORCE_SIGNAL: WantedSignal(F_Z.start, "N")}
    for i in range(3):
        for name, place in zip(ANGLE_OF_COUNT, (COUNT_M, COUNT_L), strict=True):
            zero, per_rad = count_conversion(name, belief)
            found[f"encoder.{name}[{i}]"] = WantedSignal(place.start + i, "1")
            found[f"estimator.{ANGLE_OF_COUNT[name]}[{i}]"] = WantedSignal(place.start + i, "rad", zero[i], per_rad)
        found[f"controller.omega_ref[{i}]"] = WantedSignal(OMEGA_REF.start + i, "rad/s")
        found[f"drive/{i + 1}.tau_motor"] = WantedSignal(TAU.start + i, "N m")
    return found


def followed_columns(
    where: str, columns: Mapping[str, MappedColumn], wanted: Mapping[str, WantedSignal]
) -> dict[str, MappedColumn]:
    """Select the mapped columns that the twin follows; a map may serve other commands, too."""
    found = {name: column for name, column in columns.items() if name == TIME_SIGNAL or name in wanted}
    others = [name for name in columns if name not in found]
    mistakes = [
        f"{where}: {name} = '{column.name}' names no topic; write /TOPIC.FIELD, for example /joint_states.position.m1"
        for name, column in found.items()
        if name != TIME_SIGNAL and not re.match(r"/[^.]+\.", column.name)
    ]
    there = {wanted[name].column for name in found if name != TIME_SIGNAL}
    for name, one in wanted.items():
        if one.column in ENCODER_COLUMNS and one.column not in there and name.startswith("estimator."):
            hint = nearest(name, others, f"write '{name}' = '/joint_states.position.NAME'")
            mistakes.append(f"{where}: the map lacks {name}; {hint}")
    if mistakes:
        raise LogError("\n".join(mistakes))
    return found


def readings_of(log: Log, belief: Belief) -> Iterator[Arrival]:
    """Yield the samples of a table, or of a recording of twin, as arrivals, each at its own time."""
    robot = robot_samples(log, belief)
    for name, one in wanted_signals(belief).items():
        if one.column not in (*ENCODER_COLUMNS, F_Z.start) and name in log.series:
            series = log.series[name]
            refuse_unit(f"{log.path}:", name, series.unit, one.unit)
            hold_until_sampled(robot, one.column, series.t, series.values)
    columns = tuple(range(width(INPUTS)))
    for t, row in zip(np.rint(robot.t * NS_PER_SECOND).astype(np.int64).tolist(), robot.u.tolist(), strict=True):
        yield Arrival("encoders", t, Reading(t, columns, tuple(row)))
