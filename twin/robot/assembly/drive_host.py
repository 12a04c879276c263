"""The job of a process that has one drive at a time: makes it, then answers for it until nobody asks any more."""

import base64
import os
import pickle

import numpy as np

from twin.kernel.cosim.component import Component
from twin.kernel.process.called import called_function
from twin.kernel.process.page import IDLE, STOPPED, Page, serve
from twin.kernel.process.reporter import PipeReporter
from twin.robot.assembly.drives import Start, drive, planned
from twin.robot.experiment.schema import Drive


def hosted_drive(
    reporter: PipeReporter,
    name: str,
    table: Drive,
    switched: bool,
    ticks: int | None,
    ramped: bool,
    tick: float,
    theta_m: Start,
    tau_load: Start,
    processor: int,
) -> None:
    """Make a drive and serve it.

    Notes: {"ports"} when the drive can be asked, {"explained"} after a bad status.

    Args:
        name: see `drive`.
        table: of its `DrivePlan`.
        switched: see `DrivePlan`.
        ticks: see `DrivePlan`.
        ramped: see `DrivePlan`.
        tick: see `drive`.
        theta_m: see `drive`.
        tau_load: see `drive`.
        processor: to serve on.

    Raises:
        InputRefused: the drive cannot be made.
    """
    plan = planned(table).until(ticks)
    plan = plan.switchable() if switched else plan
    component = drive(name, plan.with_lines() if ramped else plan, tick, theta_m, tau_load)
    page = Page(reporter.box, sum(p.size for p in component.inputs), sum(p.size for p in component.outputs))
    page.clear()
    # no question: compiles, or loads from the cache, before the first one comes
    _served(page, component)
    reporter.note(ports=_described(component))
    os.sched_setaffinity(0, {processor})
    status = IDLE
    while status != STOPPED:
        status = _served(page, component)
        if status not in (IDLE, STOPPED):
            reporter.note(explained=component.explain(status))
    component.close()


def _served(page: Page, component: Component) -> int:
    return serve(
        page.address, page.inputs, component.step_address, component.self_address, page.number,
        page.kernel.ctypes.data, page.nap.ctypes.data,
    )  # fmt: skip


def _described(component: Component) -> str:
    """What a component that stands for this one needs to know, packed."""
    facts = (component.inputs, component.outputs, np.array(component.initial_outputs), called_function(component))
    return base64.b64encode(pickle.dumps(facts)).decode()
