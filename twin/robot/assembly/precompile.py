"""Background compilation of the code that every run needs, if it is missing, by a second process.

`python -m twin.robot.assembly.precompile` is that process; it compiles in the opposite order.
"""

import atexit
import os
import subprocess

from twin.kernel.compiled.native import Native
from twin.kernel.cosim import component as cosim_component
from twin.kernel.cosim import master
from twin.kernel.fmi import cosim_step
from twin.kernel.process.process import environment, module_command
from twin.kernel.recording import messages as filling
from twin.kernel.recording import writer as weave
from twin.robot import scene as arrows
from twin.robot import scene as frames
from twin.robot.controller import controller
from twin.robot.mechanism import kinematics, workspace
from twin.robot.plant import component, deviation, encoder, hold_sums

TERMINATE_TIMEOUT = 5.0
"""Timeout (s) for the other process to end after a request."""
MAX_SERIAL_COMPILES = 3
"""Maximum number of missing functions compiled without help; another process needs as long to start."""


def common_functions() -> tuple[Native, ...]:
    """Return the compiled functions that a run of Fig. 4 needs, in the order of first use."""
    return (
        kinematics._angles.native, workspace._nearest.native, component._load.native, kinematics._rows.native,
        component._deflect.native, component._begin.native, component.make_step(False, False), encoder.step,
        controller.estimator_step, controller.make_step(False, False), encoder.scale_step, cosim_step.plain_step,
        master.advance.native, hold_sums.add_up.native, filling._fill.native, deviation._add_up.native,
        frames._put_poses.native,
        arrows._put_arrows.native, weave._scatter.native, cosim_component.copy_pieces.native,
    )  # fmt: skip


def compile_in_background() -> None:
    """Compile the functions that every run needs in a background process, last first, if many are not cached."""
    if (os.cpu_count() or 1) > 1 and sum(not native.has_code for native in common_functions()) > MAX_SERIAL_COMPILES:
        helper = subprocess.Popen(module_command(__name__), env=environment(), stdin=subprocess.DEVNULL)
        atexit.register(_end, helper)


def _end(helper: subprocess.Popen[bytes]) -> None:
    helper.terminate()
    helper.wait(TERMINATE_TIMEOUT)


if __name__ == "__main__":
    for native in reversed(common_functions()):
        native.address  # noqa: B018
