"""A hazard, its runs and a stage made by hand: nothing is simulated."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from twin.kernel.errors import ComponentFailed
from twin.robot.experiment.fault import Fault
from twin.studies.faults.reaction import Reaction
from twin.studies.safety.evidence import EvidenceRun, HazardLine
from twin.studies.safety.hazards import Cause, Evidence, Hazard, HazardTable

RUNAWAY = Cause((("drive_runaway", "all drives"),))
LOST_THEN_RUNAWAY = Cause((("sample_loss", "encoder"), ("drive_runaway", "all drives")), ordered=True)
TRIPPED_AFTER = 0.05
"""Time from the first fault to its trip on the stage (s)."""


def felt(peak: float, **values: Any) -> Reaction:
    """Return a reaction of a run that tripped, but for the `values` given."""
    given = {
        "seen": 0.1, "acted": 0.1, "power_off": None, "below": 0.3, "reason": "FORCE", "peak": peak, "peak_delay": 0.1,
        "above": 0.0, "impulse": 1.0, "energy": 0.1, "left": 0.5, "end": "retracted", "failure": "", "digest": "abc",
    }  # fmt: skip
    return Reaction(**given | values)


def unseen(peak: float, **values: Any) -> Reaction:
    """Return a reaction of a run without a trip."""
    return felt(peak, **{"seen": None, "acted": None, "reason": "", "end": "finished"} | values)


def hazard(key: str = "limit_N", limit: float = 22.5, causes: Sequence[Cause] = (RUNAWAY,), **evidence: Any) -> Hazard:
    words = dict.fromkeys(HazardTable.model_fields, "x") | {"id": "H1", "beyond": ""}
    return Hazard(HazardTable(**words), tuple(causes), key, limit, Evidence(**{"bodies": ("back",)} | evidence))


def run(watched: Reaction | None, **values: Any) -> EvidenceRun:
    table = {"kind": "drive_runaway", "target": "all drives", "onset_s": 5.0, "magnitude_rad_per_s": 2.0}
    given = {"cause": "runaway", "body": "back", "settings": (), "tables": (table,), "seed": 0}
    return EvidenceRun(**given | {"watched": watched} | values)


def line(*runs: EvidenceRun, of: Hazard | None = None, **values: Any) -> HazardLine:
    return HazardLine(of or hazard(), runs, **{"distances": {}, "head_area": 3e-4} | values)


class FakeStage:
    """A stage whose runs press the harder, the faster a drive runs away; 10 s at 1 ms.

    Attributes:
        asked: faults of every run, and whether the monitor watched.
        fails: error message of every run; "" if runs succeed.
    """

    settings = ("seed=3",)
    onsets = (1.0, 5.0)

    def __init__(self, body: str = "back", offset: tuple[float, float] = (0.0, 0.0), fails: str = ""):
        self.body, self.offset, self.fails = body, offset, fails
        monitor = SimpleNamespace(force_limit=15.0)
        self.experiment: Any = SimpleNamespace(
            seed=3, duration_ticks=10_000, cosim=SimpleNamespace(tick=1e-3), monitor=monitor, name="by hand"
        )
        self.asked: list[tuple[tuple[Fault, ...], bool]] = []

    def reaction(self, faults: Sequence[Fault], watched: bool = True) -> Reaction:
        self.asked.append((tuple(faults), watched))
        if self.fails == "raises":
            raise ComponentFailed("the drive crashed")
        speeds = [fault.magnitude for fault in faults if fault.kind == "drive_runaway"]
        peak = 2.0 * max(map(abs, speeds), default=0.0)
        one = felt(peak, failure=self.fails) if watched else unseen(3.0 * peak)
        return replace(one, digest=f"{peak:g}")

    def reactions(self, faults: Sequence[Fault]) -> tuple[Reaction, Reaction]:
        return self.reaction(faults), self.reaction(faults, watched=False)

    def ideal(self, faults: Sequence[Fault], seen: float) -> Reaction:
        return felt(0.5 * self.reaction(faults).peak, power_off=seen)

    def trip_after(self, first: dict[str, Any]) -> float:
        return TRIPPED_AFTER

    def delayed(self, tables: Sequence[dict[str, Any]], delay: float) -> tuple[dict[str, Any], ...]:
        first, second = tables
        return first, second | {"onset_s": round(first["onset_s"] + TRIPPED_AFTER + delay, 3)}
