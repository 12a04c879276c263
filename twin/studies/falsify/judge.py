"""Runs with a fault, judged by how near they come to violating a requirement.

One run of the search, in a warm worker: how far it is from violating what is required of it.

Warm workers that are given one batch of runs after the other: each batch depends on what the one before came to.
"""

import math
import re
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from twin.kernel.cosim.observers import simulate
from twin.kernel.errors import ComponentFailed, InputRefused, SafetyTrip
from twin.kernel.process.job import JobLimits
from twin.kernel.writing import write_text
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.measure import Required, requirement, signals_of
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.monitor.component import trip_reason
from twin.robot.run.trace import Trace, fields_of
from twin.studies.check.measurement import Signals, metrics_of_measure, refuse_unknown
from twin.studies.falsify.space import Ended, Space, TriedFault
from twin.studies.falsify.text import Requirement
from twin.studies.faults.matrix import default_onsets, fault_trial_of
from twin.studies.metrics.requirement import checked_requirement
from twin.studies.steps import Say
from twin.studies.sweep.measures import RunFinding
from twin.studies.sweep.plan import Task
from twin.studies.sweep.pool import Job, WorkerProcess

FORCE, PLACE = "plant.F_ee_B", "plant.p_B"


def judged(path: Path, drive: str | None, settings: Sequence[str], claims: str = "") -> RunFinding:
    """Run the experiment file `settings[0]`: "NAME.distance" of each of its requirements.

    A component that fails ends the run, and what is required is judged until then.

    Args:
        path, drive: of the experiment that the file extends; it says so itself.
        claims: nothing.

    Returns:
        Of a run without a fault besides `onsets`, ticks in contact and in free motion at which one may begin.
    """
    began = time.perf_counter()
    try:
        experiment = load_experiment(settings[0], (), drive)
        required = [measure for measure in experiment.measures if isinstance(measure, Required)]
        names = {name for measure in required for name, _ in signals_of(requirement(measure.formula))}
        run = Trace(only=names | {FORCE, PLACE})
        with assemble(experiment) as assembly:
            refuse_unknown(experiment, assembly.system)
            done = simulate(assembly, experiment.duration_ticks, [run])
        signals = Signals(run, geometry_of(experiment.controller.model))
        found: dict[str, float | None] = {
            name: m.value for measure in required for name, m in metrics_of_measure(measure, signals).items()
        }
        onsets: list[int] = []
        if not experiment.faults:
            try:
                # in contact first: that is where a fault can press
                onsets = list(reversed(default_onsets(fault_trial_of(run, done))))
            except InputRefused:
                onsets = [round(0.5 * experiment.duration_ticks)]
    # a mistake of ours in one run costs that run, as in a sweep
    except Exception as problem:
        status = "refused" if isinstance(problem, InputRefused) else "failed"
        return RunFinding(status, str(problem), {}, time.perf_counter() - began, 0.0)
    trip = trip_reason(done.simulation)
    status, reason = ("failed", str(done.failure)) if done.failure else ("tripped" if trip else "done", trip)
    return RunFinding(status, reason, found, time.perf_counter() - began, done.stepping, {"onsets": onsets})


TRIAL = "twin.studies.falsify.judge:judged"


class Crew:
    """See `crew`."""

    def __init__(self, idle: "SimpleQueue[WorkerProcess]", threads: ThreadPoolExecutor, stopping: threading.Event):
        self._idle, self._threads, self._stopping = idle, threads, stopping
        self._count = 0

    def findings(self, files: Sequence[Path]) -> list[dict[str, Any]]:
        """What the experiments in `files` come to, in their order, stored ones too: facts of `RunFinding`."""
        return list(self._threads.map(self._finding, files))

    def _finding(self, file: Path) -> dict[str, Any]:
        worker = self._idle.get()
        try:
            facts = worker.facts(Task(0, "", None, {}, (str(file.absolute()),)), self._stopping)
            return facts or {}
        finally:
            self._idle.put(worker)


@contextmanager
def crew(folder: Path, processes: int, limits: JobLimits = JobLimits()) -> Iterator[Crew]:  # noqa: B008, it is frozen
    """`processes` warm workers, which end when the block does.

    Args:
        folder: where the files are that they run.
        limits: of each worker.
    """
    job = Job(folder, folder, "none", limits, "", trial=TRIAL)
    idle: SimpleQueue[WorkerProcess] = SimpleQueue()
    stopping = threading.Event()
    with ExitStack() as ends:
        for _ in range(processes):
            worker = WorkerProcess(job)
            ends.callback(worker.close)
            idle.put(worker)
        threads = ends.enter_context(ThreadPoolExecutor(processes))
        # before the pool waits for its threads: what runs then is given up
        ends.callback(stopping.set)
        yield Crew(idle, threads, stopping)


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
        self.distances: dict[TriedFault, dict[str, float]] = {}
        self.first: dict[str, int] = {}
        self.ended: dict[TriedFault, Ended] = {}
        self.seconds = 0.0

    def healthy(self) -> list[int]:
        """Make the runs without a fault, on each body, and return where faults begin first (ticks).

        Raises:
            InputRefused: one violates a requirement. ComponentFailed, SafetyTrip: one fails, or trips.
        """
        unbroken = [TriedFault("", body=body) for body in self._space.bodies]
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

    def shares(self, batch: Sequence[TriedFault]) -> list[float]:
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

    def _found(self, batch: Sequence[TriedFault]) -> list[dict]:
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
