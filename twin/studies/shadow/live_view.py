"""Live view of a session: robot and plant model in one scene, all topics, and the button that accepts a proposal."""

import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.kernel.atomic_write import json_text
from twin.kernel.cosim.delay import values_by_port
from twin.kernel.cosim.observers import TickEvent
from twin.kernel.cosim.port import Port
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.recording.messages import MessageForm, Topic
from twin.kernel.recording.recorder import RowStream, port_fields
from twin.robot.controller.controller import ESTIMATOR_OUTPUTS
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.plant.component import PLANT_OUTPUTS as MOTION
from twin.robot.scene import (
    ARROWS_WIDTH,
    POSE_SIZE,
    SCENE_FRAMES,
    Drawing,
    arrows,
    force_example,
    poses,
    scene_update,
    second_robot,
    surface_pose,
    transforms_example,
)
from twin.studies.replay.parts import Happening, Rows
from twin.studies.replay.recording import NANOSECOND_TICK
from twin.studies.shadow import ACCEPT_PARAMETER, ACCEPTED_PARAMETER, LINE_PARAMETER, PROPOSAL_PARAMETER
from twin.studies.shadow.following import Twin
from twin.studies.shadow.reidentification import Adaptation

if TYPE_CHECKING:
    from twin.robot.live.server import LiveServer

MODEL_PREFIX = "plant/"
"""Prefix of the frames of the plant model; the robot's frames have the names of a run."""


def accepted_values(accepted: Sequence[Adaptation]) -> str:
    """Format the newest value of each accepted parameter as JSON, a list of objects.

    "text" is the sentence of the proposal, "field" and "leg" (-1: all) name a field of `PlantParameters`, "value" and
    "half_width" (95 %) are in the SI "unit"; for "k_s_share" they are the spring's, N m/rad.
    """
    newest = {(one.field, one.leg): one for adaptation in accepted for one in adaptation.changes}
    return json_text([
        {"text": str(one), "field": one.field, "leg": one.leg, "value": one.now.value,
         "half_width": one.now.half_width, "unit": one.unit}
        for one in newest.values() if one.now is not None
    ])  # fmt: skip


class AcceptButton:
    """Thread-safe viewer parameters: button `shadow.accept`, proposal of the twin, status line."""

    def __init__(self, twin: Twin):
        self._twin, self.line = twin, ""
        self._asked: Adaptation | None = None
        self._lock = threading.Lock()

    def values(self) -> Mapping[str, bool | float | str]:
        """Present values of the session's viewer parameters by name; see `Parameters`."""
        return {
            ACCEPT_PARAMETER: self._asked is not None,
            PROPOSAL_PARAMETER: str(self._twin.proposal or ""),
            ACCEPTED_PARAMETER: accepted_values(self._twin.adaptations),
            LINE_PARAMETER: self.line,
        }

    def request(self, name: str, value: object, /) -> None:
        """Request a viewer parameter, see `Parameters`; true accepts the open proposal; raise `InputRefused`."""
        accepts = f"accepts what {PROPOSAL_PARAMETER} says"
        if name in (PROPOSAL_PARAMETER, ACCEPTED_PARAMETER, LINE_PARAMETER):
            raise InputRefused(f"{name} is set by the twin; {ACCEPT_PARAMETER} = true {accepts}")
        if name != ACCEPT_PARAMETER:
            hint = nearest(name, [ACCEPT_PARAMETER], f"there is {ACCEPT_PARAMETER}")
            raise InputRefused(f"{name}: no such parameter; {hint}")
        if not isinstance(value, bool):
            raise InputRefused(f"{ACCEPT_PARAMETER} = {value!r}: expected true, which {accepts}")
        proposal = self._twin.proposal
        if value and proposal is None:
            raise InputRefused(f"{ACCEPT_PARAMETER}: there is no proposal to accept")
        with self._lock:
            self._asked = proposal if value else None

    def press(self) -> str | None:
        """Accept the proposal requested by a viewer. Return an error message, "" on success, None without a request."""
        with self._lock:
            asked, self._asked = self._asked, None
        if asked is None:
            return None
        return "" if self._twin.accept(asked) else f"not accepted, for it is not open any more: {asked}"


class TwoRobots:
    """Drawing for viewers, see `Drawn`: the robot by its counts, and over it the plant model."""

    def __init__(self, experiment: Experiment, places: Mapping[str, slice]):
        self._geometry, self._places = geometry_of(experiment.plant), places
        self._surface = surface_pose(experiment.contact)[None]
        robot = scene_update(self._geometry, experiment.contact)
        robot.MergeFrom(second_robot(MODEL_PREFIX, robot))
        self.forms: Sequence[MessageForm] = (
            MessageForm("scene", robot, 0, 1),
            MessageForm("tf", transforms_example(), POSE_SIZE * len(SCENE_FRAMES), 1),
            MessageForm(f"{MODEL_PREFIX}tf", transforms_example(MODEL_PREFIX), POSE_SIZE * len(SCENE_FRAMES), 1),
            MessageForm("force", force_example(), ARROWS_WIDTH, 1),
        )
        # load compiled functions before the first sample arrives
        list(self.drawings(0, np.zeros((1, max(place.stop for place in places.values())))))

    def drawings(self, first: int, rows: NDArray[np.float64], /) -> Iterator[Drawing]:
        """Yield drawings of robot and plant model for rows, see `Drawn`; a robot without a known pose is left out."""
        yield Drawing("scene", first, np.empty((1, 0)))
        robot = values_by_port(ESTIMATOR_OUTPUTS, rows[:, self._places["estimator"]])
        model = values_by_port(MOTION, rows[:, self._places["plant"]])
        known = []
        for name, its in (("tf", robot), (f"{MODEL_PREFIX}tf", model)):
            known.append(bool(np.all(np.isfinite(its["theta_l"])) and np.all(np.isfinite(its["p_B"]))))
            if known[-1]:
                frames = poses(self._geometry, its["theta_l"], its["p_B"], self._surface)
                yield Drawing(name, first, frames.reshape(1, -1))
        if all(known):
            yield Drawing("force", first, arrows(robot["p_B"], model["F_ee_B"], robot["F_ee_B"]))


class ShadowViewer:
    """Connection to viewers through a server that never waits; slow viewers do not delay the session."""

    def __init__(
        self, server: "LiveServer", topics: Mapping[str, tuple[Port, ...]], experiment: Experiment, twin: Twin
    ):
        self._server, self._button = server, AcceptButton(twin)
        self._places, whole, end = dict[str, slice](), list[bool](), 0
        streams = []
        for name, ports in topics.items():
            whole += [port.kind != "double" for port in ports for _ in range(port.size)]
            self._places[name] = slice(end, end := len(whole))
            streams.append(RowStream(Topic(name, port_fields(ports), 1), self._places[name]))
        self._whole, self._answers = np.array(whole), {PROPOSAL_PARAMETER: "", ACCEPTED_PARAMETER: accepted_values(())}
        # topics without a row yet have no numbers; only fractions can be NaN
        self._row = np.where(self._whole, 0.0, np.nan)[None]
        self._tick = 0
        server.begin(streams, TwoRobots(experiment, self._places), NANOSECOND_TICK, self._button)

    def press(self) -> str:
        """Accept the proposal requested by a viewer. Return an error message, or ""."""
        text = self._button.press()
        if text is not None:
            self._server.send_parameters([ACCEPT_PARAMETER, PROPOSAL_PARAMETER, ACCEPTED_PARAMETER])
        return text or ""

    def say(self, line: str) -> None:
        self._button.line = line
        self._server.send_parameters([LINE_PARAMETER])

    def show(self, times: NDArray[np.int64], rows: Rows, happened: Sequence[Happening]) -> None:
        """Send samples at `times` (n,), ns, with the twin's rows, and events to the viewers."""
        for topic, own in rows.items():
            # usually the last one
            newest = next((row for row in own[::-1] if not np.isnan(row).all()), None)
            if newest is not None:
                self._row[0, self._places[topic]] = newest
        self._row[0, self._whole & np.isnan(self._row[0])] = 0.0
        self._tick = int(times[-1]) if len(times) else self._tick
        events = [TickEvent(max(0, round(one.t / NANOSECOND_TICK)), "WARNING", one.text, "shadow") for one in happened]
        self._server.show(self._tick, self._row, events)
        values = self._button.values()
        changed = [name for name, before in self._answers.items() if values[name] != before]
        if changed:
            self._answers |= {name: str(values[name]) for name in changed}
            self._server.send_parameters(changed)
