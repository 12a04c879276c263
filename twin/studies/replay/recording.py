"""Recording of a replay, with the signal names of a run."""

import json
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.port import Port
from twin.kernel.recording.messages import Topic
from twin.kernel.recording.recorder import port_fields
from twin.kernel.recording.writer import Writer
from twin.robot.controller.controller import ESTIMATOR_OUTPUTS as ESTIMATES
from twin.robot.plant.component import PLANT_OUTPUTS as MOTION
from twin.robot.plant.encoder import SCALE_OUTPUTS as SCALE
from twin.studies.replay.parts import ENCODER_PORTS, FORCE_RESIDUAL, JOINT_RESIDUAL, RESTART_TEXT
from twin.studies.replay.replay import Outputs, Replay

NANOSECOND_TICK = 1e-9
"""Tick of the recording (s): a robot's clock has no ticks, so times are nanoseconds."""
SPAN_TICKS = 10**8
"""Span of the log written at once (0.1 s, in ticks), so that topics are interleaved in the file."""
SUM_MEANINGS = {
    "mean": "mean residual of the block that ends here",
    "up": "Page's cumulative sum against an increase",
    "low": "Page's cumulative sum against a decrease",
}


class Track(NamedTuple):
    """Rows of one recorded topic. topic: its fields; ticks: times of the rows (n,), ascending; rows: (n, width)."""

    topic: Topic
    ticks: NDArray[np.int64]
    rows: NDArray[np.float64]


def record(replay: Replay, path: Path) -> Path:
    tracks = _tracks(replay)
    model, log = replay.model, replay.log.path.name
    experiment = {"name": model.name, "title": f"replay of {log}", "values": json.dumps(model.values)}
    metadata = {"experiment": experiment, "replay": {"log": log}}
    with Writer(path, [track.topic for track in tracks], NANOSECOND_TICK, metadata) as writer:
        # only spans with rows, since gaps may last hours
        spans = np.unique(np.concatenate([track.ticks for track in tracks]) // SPAN_TICKS)
        for start in (spans * SPAN_TICKS).tolist():
            for topic, ticks, rows in tracks:
                first, last = np.searchsorted(ticks, (start, start + SPAN_TICKS))
                # write evenly spaced rows at once
                uneven = np.flatnonzero(np.diff(ticks[first:last]) != topic.period) + 1
                for a, b in pairwise([first, *(first + uneven), last]):
                    if a < b:
                        writer.write(topic.name, int(ticks[a]), rows[a:b])
            writer.end_slice()
        for tick, text in _events(replay):
            writer.write_event(tick, "WARNING", text, "replay")
        return writer.finish()


def _tracks(replay: Replay) -> list[Track]:
    t = replay.log.t
    tracks = [
        _track("encoder", ENCODER_PORTS, t, {name: replay.log.only(name) for name in ("count_m", "count_l")}),
        _track("estimator", ESTIMATES, t, replay.estimator),
    ]
    if replay.twin is not replay.estimator:
        tracks.append(_track("twin", ESTIMATES, t, replay.twin))
    if replay.plant is not None and replay.joints is not None:
        tracks.append(_track("plant", MOTION, t, replay.plant))
        tracks.append(_track("residual/joints", JOINT_RESIDUAL, t, {"theta_l": replay.joints}))
    if replay.log.force is not None:
        force = replay.log.force
        inside = force.t >= 0.0
        tracks.append(_track("scale", SCALE, force.t[inside], {"F_z": force.values[inside]}))
    for name, residual in replay.forces.items():
        tracks.append(_track(f"residual/{name}", FORCE_RESIDUAL, residual.t, {"F_z": residual.r}))
    for one in replay.indicators:
        ports = tuple(Port(name, 1, one.unit, meaning) for name, meaning in SUM_MEANINGS.items())
        values = {"mean": one.drift.mean, "up": one.drift.up, "low": one.drift.low}
        tracks.append(_track(f"drift/{one.name.replace(' ', '_')}", ports, one.drift.t, values))
    return tracks


def _track(name: str, ports: tuple[Port, ...], t: NDArray[np.float64], outputs: Outputs) -> Track:
    fields = port_fields(ports)
    ticks = np.rint(t / NANOSECOND_TICK).astype(np.int64)
    # the shortest interval
    period = int(np.min(np.diff(ticks), initial=SPAN_TICKS))
    return Track(Topic(name, fields, period), ticks, np.column_stack([outputs[p.name] for p in ports]).astype(float))


def _events(replay: Replay) -> list[tuple[int, str]]:
    """List the events of a replay in order of time: gaps, restarts of the plant model, and alarms."""
    found = [(start, f"no samples for {end - start:.3g} s") for start, end in replay.log.sampling.gaps]
    found += [(start, RESTART_TEXT) for start in replay.starts[1:]]
    found += [
        (one.drift.alarm, f"{one.name} no longer matches, since {one.drift.since:.3f} s")
        for one in replay.indicators
        if not one.drift.matches
    ]
    return [(round(t / NANOSECOND_TICK), text) for t, text in sorted(found)]
