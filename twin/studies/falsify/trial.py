"""One run of the search, in a warm worker: how far it is from violating what is required of it."""

import time
from collections.abc import Sequence
from pathlib import Path

from twin.errors import InputRefused
from twin.experiment.measure import Required
from twin.experiment.requirement import requirement, signals_of
from twin.runs.assembly.assemble import assemble
from twin.runs.assembly.beliefs import geometry_of
from twin.runs.assembly.load import load_experiment
from twin.runs.loop import simulate
from twin.runs.trace import Trace
from twin.studies.check.measurement import metrics_of_measure
from twin.studies.check.signals import Signals, refuse_unknown
from twin.studies.faults.onset import default_onsets
from twin.studies.faults.trial import fault_trial_of
from twin.studies.sweep.measures import RunFinding

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
    status, reason = ("failed", str(done.failure)) if done.failure else ("tripped" if done.trip else "done", done.trip)
    return RunFinding(status, reason, found, time.perf_counter() - began, done.stepping, {"onsets": onsets})
