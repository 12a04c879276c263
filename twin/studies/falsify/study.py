"""The search for the worst case, from an experiment's file to the experiments that it found."""

import math
import os
import re
from collections.abc import Sequence
from pathlib import Path

from twin.errors import ComponentFailed, InputRefused, SafetyTrip
from twin.experiment.experiment import Experiment
from twin.experiment.measure import Required
from twin.experiment.named import experiment_file
from twin.experiment.source import Source, override
from twin.runs.assembly.assemble import assemble
from twin.runs.assembly.load import load_experiment
from twin.runs.streams import fields_of
from twin.studies.answer import Answer
from twin.studies.falsify.crew import Crew, crew
from twin.studies.falsify.holes import Ended, Holes
from twin.studies.falsify.search import Search
from twin.studies.falsify.space import Space, Wrong
from twin.studies.falsify.text import Found, Requirement, falsify_text, header
from twin.studies.faults.case import cases, known_kinds
from twin.studies.left_behind import SCRATCH, held_folder
from twin.studies.metrics.checked_requirement import checked_requirement
from twin.studies.steps import Say
from twin.studies.tune.fragment import findable
from twin.writing import made_folder, write_json, write_text

HOME = Path("results") / "falsify"
FOUND = "falsify.json"
RUNS = 240
"""Three quarters of what `twin faults` makes of all kinds, 160 cases with the monitor and without: enough for the race
to be in each of their 135 places."""


def falsify(
    experiment: Path,
    requirements: Sequence[str],
    kinds: Sequence[str],
    bodies: Sequence[str],
    runs: int,
    duration: float | None,
    processes: int,
    drive: str | None,
    settings: Sequence[str],
    out: Path | None,
    say: Say,
) -> Answer:
    """Search for the fault that takes an experiment furthest beyond what is required of it.

    Each kind that violates a requirement becomes an experiment, KIND.toml, in `out` or results/falsify/EXPERIMENT.
    Exit code 1: one does.

    Args:
        experiment: its file or name.
        requirements: formulas; without one, those of its [[measure]] tables.
        kinds: of faults, see `known_kinds`.
        bodies: what else than the experiment's own body is pressed on.
        runs: the most that are made, the healthy ones not counted.
        duration: of each fault (s); None: to the end.
        processes: of workers.
        drive, settings: see `load_experiment`.
        out: folder.
        say: told how many runs are made.

    Raises:
        InputRefused: an option or a formula cannot be used, or a requirement is violated without any fault.
        ComponentFailed, SafetyTrip: the healthy run fails, or its monitor trips.
        NotWritten: the disk refuses.
    """
    if os.name != "posix":
        raise InputRefused("twin falsify: needs Linux or macOS, where a drive that crashes can be kept apart")
    chosen, path = known_kinds(kinds), experiment_file(experiment)
    if runs < len(chosen):
        raise InputRefused(f"--runs {runs}: there are {len(chosen)} kinds of fault; expected one run for each at least")
    loaded = load_experiment(path, settings, drive)
    wanted = _requirements(loaded, requirements, path)
    # a duration is refused as `twin faults` refuses it
    cases(loaded, (), (), duration)
    base = Source()
    override(base, settings)
    if drive is not None:
        base.values.setdefault("drive", {})["fmu"] = loaded.values["drive"]["fmu"]
    space = Space(
        base.values,
        [(requirement.name, requirement.formula) for requirement in wanted],
        chosen,
        loaded.duration_ticks,
        loaded.cosim.tick,
        duration,
        list(dict.fromkeys([None, *bodies])),
        loaded.seed,
        loaded.plant.motor_noise > 0.0 or loaded.plant.joint_noise > 0.0,
    )
    folder = made_folder(out or HOME / path.stem).absolute()
    with held_folder(SCRATCH) as scratch, crew(scratch, processes) as workers:
        judge = _Judge(space, wanted, workers, path.resolve(), scratch, runs, say)
        onsets = judge.healthy()
        search = Search(space, judge.shares, runs, onsets)
        search.go()
    order = {wrong: number for number, wrong in enumerate(search.tried, start=1)}
    ended = judge.ended
    found = [
        Found(wrong, judge.distances[wrong], share, order[wrong], judge.first.get(wrong.kind), ended.get(wrong))
        for wrong, share in sorted(search.worst.values(), key=lambda pair: pair[1])
        if math.isfinite(share)
    ]
    violating = [one for one in found if one.share < 0.0]
    for one in violating:
        text = space.file(one.wrong, findable(path, folder), header(path.stem, one, wanted))
        write_text(folder / f"{one.wrong.kind}.toml", text)
    holes = Holes.of(space, list(search.tried), judge.ended, {one.wrong.kind for one in violating})
    facts = {
        "experiment": path.stem,
        "requirements": [vars(requirement) for requirement in wanted],
        "runs": len(search.tried),
        "seconds": judge.seconds,
        "found": [one.facts(space) for one in found],
        **holes.facts,
    }
    write_json(folder / FOUND, facts)
    shown = out or HOME / path.stem
    text = falsify_text(path.stem, wanted, found, holes, space, len(search.tried), judge.seconds, shown)
    return Answer(text, facts, 1 if violating else 0)


class _Judge:
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
            for requirement in self._requirements:
                left = self._distance(facts, requirement.name)
                if left < 0.0:
                    raise InputRefused(
                        f'"{requirement.formula}": violated without any fault{on}, by {-left:.3g} {requirement.unit}; '
                        "require what the healthy robot keeps"
                    )
                least = min(self._scales.get(requirement.name, math.inf), left)
                self._scales[requirement.name] = least
        # nothing but true and false, or a bound that is just kept: then metres and newtons are as good as shares
        self._scales = {name: s if 1e-9 < s < math.inf else 1.0 for name, s in self._scales.items()}
        return onsets

    def shares(self, batch: Sequence[Wrong]) -> list[float]:
        """See `Judge`. Of a run that a failed component ended, until then; of one that is refused, infinite."""
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


def _requirements(experiment: Experiment, texts: Sequence[str], path: Path) -> list[Requirement]:
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
