"""`twin falsify`: the worst case by search."""

import math
import os
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from twin.kernel.errors import InputRefused
from twin.studies.command import Argument, DriveName, Option, Say, Settings, study
from twin.studies.precheck import load_experiments
from twin.studies.result import Result

RESULTS_FOLDER = Path("results") / "falsify"
RESULT_FILE = "falsify.json"
DEFAULT_RUNS = 260
"""Enough for the race to be in each of the 140 places of all kinds."""


class Sets(StrEnum):
    """Number of simultaneous faults that the search may combine."""

    SINGLE = "single"
    COMMON = "common"
    PAIRS = "pairs"
    ORDERED = "ordered"


@study(before=[load_experiments])
def falsify(
    experiment: Annotated[Path, Argument("Experiment (TOML).", "EXPERIMENT", complete="experiment")],
    say: Say,
    requirements: Annotated[
        Sequence[str],
        Option(
            "Requirement; may be repeated. Default: the experiment's own requirements.",
            "FORMULA",
            "--requirement",
        ),
    ] = (),
    kinds: Annotated[
        Sequence[str],
        Option(
            "Only this kind of fault, or set: KIND@GROUP, KIND+KIND, KIND-then-KIND; may be repeated.", "KIND", "--kind"
        ),
    ] = (),
    sets: Annotated[
        Sequence[Sets],
        Option(
            "Single faults, common causes, pairs, or pairs one after the other; may be repeated. Default: single.",
            "single|common|pairs|ordered",
            "--set-of",
        ),
    ] = (Sets.SINGLE,),
    bodies: Annotated[Sequence[str], Option("Also press on this body; may be repeated.", "BODY", "--body")] = (),
    reach: Annotated[
        float, Option("Also move all tasks sideways, by up to this much.", "MM", "--reach-mm", least=0.0)
    ] = 0.0,
    runs: Annotated[int, Option("Maximum number of runs with a fault.", "N", least=1)] = DEFAULT_RUNS,
    duration: Annotated[float | None, Option("Duration of each fault; default: to the end of the run.", "S")] = None,
    processes: Annotated[
        int | None,
        Option("Number of parallel processes; default: number of cores.", "N", "-j --processes", least=1),
    ] = None,
    drive: DriveName = None,
    settings: Settings = (),
    out: Annotated[Path | None, Option("Folder; default: results/falsify/EXPERIMENT.", "DIR")] = None,
) -> Result:
    """Search for the fault that violates a requirement most.

    The search varies kind, joint, onset, magnitude, sign, body and seed, also
    of common causes, such as drive_runaway@all_drives, and of two faults: both
    at once, such as drive_runaway+sample_loss, or the second 0 to 3 s after the
    trip of the first, such as sample_loss-then-drive_runaway@all_drives.

    A requirement is a formula over recorded signals, such as always
    (|plant.F_ee_B| <= 18 N). A violation is written as an experiment: run it,
    or check it with twin check. Exit code: 0 every run keeps it, 1 a run
    violates it, 2 input refused, 3 a component failed without any fault, 4 the
    monitor tripped without any fault.

    Example: twin falsify experiments/pressing.toml --requirement "always (|plant.F_ee_B| <= 18 N)"
    """
    from twin.kernel.atomic_write import make_folder, write_json, write_text
    from twin.kernel.process.job import JobLimits, core_count
    from twin.robot.assembly.load import load_experiment
    from twin.robot.experiment.experiment_files import experiment_file
    from twin.robot.experiment.source import Source, apply_overrides
    from twin.studies.falsify.judge import TRIAL_JOB, Judge, requirements_of
    from twin.studies.falsify.search import Search
    from twin.studies.falsify.space import Space, known_sets
    from twin.studies.falsify.text import NearestRun, UnviolatedKinds, falsify_result, header
    from twin.studies.faults.cases import cases
    from twin.studies.stale_files import held_folder
    from twin.studies.sweep.engine import Job, run_pool
    from twin.studies.tune.text import findable_path

    if os.name != "posix":
        raise InputRefused("twin falsify: needs Linux or macOS, where a drive that crashes can be kept apart")
    chosen, path = known_sets(kinds, [*sets]), experiment_file(experiment)
    if runs < len(chosen):
        raise InputRefused(f"--runs {runs}: there are {len(chosen)} kinds of fault; expected one run for each at least")
    loaded = load_experiment(path, settings, drive)
    wanted = requirements_of(loaded, requirements, path)
    # a duration is refused as `twin faults` refuses it
    cases(loaded, (), (), duration)
    if reach and not loaded.tasks:
        raise InputRefused(f"--reach-mm {reach:g}: {path} has no [[task]] that could be moved")
    base = Source()
    apply_overrides(base, settings)
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
        loaded.tasks,
        1e-3 * reach,
    )
    shown = make_folder(out or RESULTS_FOLDER / path.stem)
    folder = shown.absolute()
    job = Job(path, folder, "none", JobLimits(), "", TRIAL_JOB)
    with held_folder() as scratch, run_pool(job, processes or core_count()) as workers:
        judge = Judge(space, wanted, workers, path.resolve(), scratch, runs, say)
        onsets = judge.run_healthy()
        search = Search(space, judge.shares, runs, onsets)
        search.spend_runs()
    order = {wrong: number for number, wrong in enumerate(search.tried, start=1)}
    ended = judge.ended
    found = [
        NearestRun(wrong, judge.distances[wrong], share, order[wrong], judge.first.get(wrong.kind), ended.get(wrong))
        for wrong, share in sorted(search.worst.values(), key=lambda pair: pair[1])
        if math.isfinite(share)
    ]
    violating = [one for one in found if one.share < 0.0]
    for one in violating:
        text = space.file(one.wrong, findable_path(path, folder), header(path.stem, one, wanted), judge.trip(one.wrong))
        write_text(folder / f"{one.wrong.kind}.toml", text)
    holes = UnviolatedKinds.from_search(space, list(search.tried), judge.ended, {one.wrong.kind for one in violating})
    result = falsify_result(path.stem, wanted, found, holes, space, len(search.tried), judge.seconds, shown)
    write_json(folder / RESULT_FILE, result.facts)
    return result
