"""Start of an experiment's faults by hand, while it is stepped."""

from collections.abc import Callable

from twin.kernel.cosim.system import System
from twin.kernel.errors import InputRefused
from twin.robot.assembly.build import surface_motions
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS, NO_END_TICK
from twin.robot.faults import FaultComponent
from twin.robot.plant.surface_motion import Body


class FaultStarts:
    """Buttons that start the faults of a run: keys `fault.N.start` for the [[fault]] table N.

    `moved` is called with index, onset and end (ticks) of each started fault, before the slice of its onset.
    """

    def __init__(self, experiment: Experiment, system: System, moved: Callable[[int, int, int], None]):
        self.keys = {f"fault.{table}.start": table for table in sorted({fault.table for fault in experiment.faults})}
        self._experiment, self._system, self._moved = experiment, system, moved

    def require_button(self, key: str, value: object) -> None:
        """Reject a value that does not start a fault."""
        if value is not True:
            raise InputRefused(f"{key} = {value!r}: expected true, which starts the fault; it cannot be undone")

    def start(self, key: str, tick: int) -> None:
        """Let the faults of a table begin at `tick`; a limited fault keeps its duration."""
        for index, fault in enumerate(self._experiment.faults):
            if fault.table != self.keys[key]:
                continue
            for component in self._system.components:
                # fault_1, and fault_1_power behind it
                if isinstance(component, FaultComponent) and component.name.split("_")[:2] == ["fault", str(index + 1)]:
                    component.begin_at(tick)
            end = NO_END_TICK if fault.end == NO_END_TICK else fault.end - fault.onset + tick
            if FAULT_KINDS[fault.kind].mechanism == "body":
                self._move_surface(index, tick, end)
            self._moved(index, tick, end)

    def _move_surface(self, index: int, tick: int, end: int) -> None:
        body = self._system.component("body")
        if not isinstance(body, Body):
            return
        before = self._experiment.faults[:index]
        place = len(surface_motions(self._experiment.contact))
        place += sum(FAULT_KINDS[fault.kind].mechanism == "body" for fault in before)
        motion = body.pointers["motions"][place : place + 1]
        motion["onset"] = tick * self._system.tick
        if end != NO_END_TICK:
            motion["end"] = end * self._system.tick
