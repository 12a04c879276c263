"""Runs with a fault, judged by how near they come to violating a requirement."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

from twin.errors import ComponentFailed, InputRefused, SafetyTrip
from twin.experiment.experiment import Experiment
from twin.experiment.measure import Required
from twin.runs.assembly.assemble import assemble
from twin.runs.streams import fields_of
from twin.studies.falsify.crew import Crew
from twin.studies.falsify.holes import Ended
from twin.studies.falsify.space import Space, Wrong
from twin.studies.falsify.text import Requirement
from twin.studies.metrics.checked_requirement import checked_requirement
from twin.studies.steps import Say
from twin.writing import write_text


class Judge:
    """Runs runs and tells how near they came, in shares of what the healthy run on the same body keeps."""

    def __init__(
        self,
        space: Space,
        requirements: Sequence[Requirement],
        workers: Crew,
        experiment: Path,
        scratch: Path,
        runs: int,
        say: Say,
    ):
        self._space, self._requirements, self._workers = space, requirements, workers
        self._experiment, self._scratch, self._runs, self._say = experiment, scratch, runs, say
        self._scales: dict[str, float] = {}
        self.distances: dict[Wrong, dict[str, float]] = {}
        self.first: dict[str, int] = {}
        self.ended: dict[Wrong, Ended] = {}
        self.seconds = 0.0

    def healthy(self) -> list[int]:
        """Make the runs without a fault, on each body, and return where faults begin first (ticks).

        Raises:
            InputRefused: one violates a requirement. ComponentFailed, SafetyTrip: one fails, or trips.
        """
        unbroken = [Wrong("", body=body) for body in self._space.bodies]
        onsets: list[int] = []
        for wrong, facts in zip(unbroken, self._found(unbroken), strict=True):
            on = f" on {wrong.body}" if wrong.body else ""
            if facts.get("status") == "refused":
                raise InputRefused(facts["reason"])
            if facts.get("status") != "done":
                kind = SafetyTrip if facts.get("status") == "tripped" else ComponentFailed
                raise kind(f"without any fault{on}: {facts.get('reason')}")
            onsets = onsets or facts["onsets"]
            for wanted in self._requirements:
                left = self._distance(facts, wanted.name)
                if left < 0.0:
                    raise InputRefused(
                        f'"{wanted.formula}": violated without any fault{on}, by {-left:.3g} {wanted.unit}; '
                        "require what the healthy robot keeps"
                    )
                least = min(self._scales.get(wanted.name, math.inf), left)
                self._scales[wanted.name] = least
        # nothing but true and false, or a bound that is just kept: then metres and newtons are as good as shares
        self._scales = {name: s if 1e-9 < s < math.inf else 1.0 for name, s in self._scales.items()}
        return onsets

    def shares(self, batch: Sequence[Wrong]) -> list[float]:
        """Of each run: until then if a failed component ended it, infinite if it is refused."""
        shares = []
        for wrong, facts in zip(batch, self._found(batch), strict=True):
            distances = {name: self._distance(facts, name) for name in self._scales}
            share = min((distances[name] / scale for name, scale in self._scales.items()), default=math.inf)
            self.distances[wrong] = distances
            if facts.get("status") not in ("done", "tripped"):
                self.ended[wrong] = Ended(facts.get("status") == "refused", facts.get("reason") or "")
            if share < 0.0:
                self.first.setdefault(wrong.kind, len(self.distances))
            shares.append(share)
        return shares

    @staticmethod
    def _distance(facts: dict, name: str) -> float:
        value = facts.get("metrics", {}).get(f"{name}.distance")
        return math.inf if value is None else value

    def _found(self, batch: Sequence[Wrong]) -> list[dict]:
        files = []
        for number, wrong in enumerate(batch):
            files.append(self._scratch / f"{number}.toml")
            write_text(files[-1], self._space.file(wrong, self._experiment))
        self._say(f"{len(self.distances)} of {self._runs} runs", len(self.distances) / self._runs)
        facts = self._workers.findings(files)
        self.seconds += sum(one.get("seconds") or 0.0 for one in facts)
        return facts


def requirements_of(experiment: Experiment, texts: Sequence[str], path: Path) -> list[Requirement]:
    """What is required, checked against the signals that a recording of `experiment` has.

    Raises:
        InputRefused: nothing is, or it cannot be judged.
    """
    if experiment.faults:
        raise InputRefused(f"{path}: has [[fault]] tables; the search puts in one fault at a time, remove them")
    named = [(measure.name, measure.formula) for measure in experiment.measures if isinstance(measure, Required)]
    named = [(f"requirement_{number}", text) for number, text in enumerate(texts, start=1)] or named
    if not named:
        raise InputRefused(
            f"{path}: nothing is required of it; say --requirement 'always (|plant.F_ee_B| <= 18 N)', or what else has "
            "to hold"
        )
    with assemble(experiment) as assembly:
        fields = fields_of(assembly.system)
    found = []
    for name, text in named:
        plain = re.sub(r"\s+", " ", text).strip()
        _, unit = checked_requirement(plain, fields)
        found.append(Requirement(name, plain, unit))
    return found
