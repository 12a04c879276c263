"""A run as it goes, turned into what viewers draw."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from numpy.typing import NDArray

from twin.cosim.system import System
from twin.experiment.experiment import Experiment
from twin.plant.contact_law import Contact
from twin.recording.form import BLANK_TIME, Form, blank
from twin.runs.assembly.beliefs import geometry_of
from twin.runs.scene.arrows import WIDTH, arrows, force_example
from twin.runs.scene.frames import BASE, FRAMES, POSE, poses
from twin.runs.scene.parts import pose, scene_update
from twin.runs.scene.rotation import X, Y, product, turn

PICTURE_RATE = 50.0
"""Pictures per second (Hz)."""


class Drawing(NamedTuple):
    """Rows for one of the scene's forms: its name, the tick of the first row, (n, width)."""

    name: str
    first_tick: int
    rows: NDArray[np.float64]


class Scene:
    """Draws the rows of a run.

    Attributes:
        forms: what its drawings are written as: `scene`, `tf` and `force`.
    """

    def __init__(self, experiment: Experiment, system: System):
        """Of the run of `experiment` by `system`, which has a plant and an estimator, and perhaps a moving body."""
        self._period = max(1, round(1.0 / (PICTURE_RATE * system.tick)))
        self._geometry = geometry_of(experiment.plant)
        self._surface = surface_pose(experiment.contact)
        moves = any(component.name == "body" for component in system.components)
        self._s_B = system.columns("body.s_B") if moves else None
        self._theta_l, self._p_B = system.columns("plant.theta_l"), system.columns("plant.p_B")
        self._F_ee_B, self._estimate_B = system.columns("plant.F_ee_B"), system.columns("estimator.F_ee_B")
        self.forms = (
            Form("scene", scene_update(self._geometry, experiment.contact), 0, experiment.duration_ticks + 1),
            Form("tf", transforms_example(), POSE * len(FRAMES), self._period),
            Form("force", force_example(), WIDTH, self._period),
        )

    def drawings(self, first: int, rows: NDArray[np.float64]) -> Iterator[Drawing]:
        """What is to be seen of `rows` of the run, (n, outputs of the system), the first of which is tick `first`."""
        if first == 0:
            yield Drawing("scene", 0, np.empty((1, 0)))
        start = -first % self._period
        shown = rows[start :: self._period]
        if len(shown):
            p_B = shown[:, self._p_B]
            surface = np.repeat(self._surface[None], len(shown), axis=0)
            if self._s_B is not None:
                surface[:, :3] += shown[:, self._s_B]
            frames = poses(self._geometry, shown[:, self._theta_l], p_B, surface)
            yield Drawing("tf", first + start, frames.reshape(len(shown), -1))
            yield Drawing("force", first + start, arrows(p_B, shown[:, self._F_ee_B], shown[:, self._estimate_B]))


def surface_pose(contact: Contact) -> NDArray[np.float64]:
    """Position and quaternion of the surface at rest in B, (7,): its apex, R_y(tilt) R_x(tilt_x) as in the plant."""
    q = product(turn(Y, contact.tilt), turn(X, contact.tilt_x))
    return np.concatenate([[0.0, 0.0, contact.height], q])


def transforms_example() -> FrameTransforms:
    """A `foxglove.FrameTransforms` of all `FRAMES` with blanks in the order of `poses`."""
    transforms = []
    for number, frame in enumerate(FRAMES):
        x, y, z, *q = (blank(POSE * number + i) for i in range(POSE))
        where = pose((x, y, z), q)
        transforms.append(
            FrameTransform(
                timestamp=BLANK_TIME,
                parent_frame_id=BASE,
                child_frame_id=frame,
                translation=where.position,
                rotation=where.orientation,
            )
        )
    return FrameTransforms(transforms=transforms)
