"""`twin branch`: several continuations of a run from one moment, compared."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from twin.kernel.errors import InputRefused
from twin.studies.command import Argument, BodyName, Option, Say, study
from twin.studies.precheck import print_latest
from twin.studies.result import Block, Column, Note, Result, Table, note

if TYPE_CHECKING:
    import numpy as np

    from twin.robot.run.handover import BranchPoint
    from twin.robot.run.run import Run

    Force = tuple[np.ndarray, np.ndarray]
    """Times (s) and true pressing force (N) of a run, (n,) each."""

RESULTS_FOLDER = Path("results") / "branches"
PICTURE_FILE = "branches.png"
MIN_DIFFERENCE = 1e-3
"""Minimum difference (N) of the true force that counts as a departure from the run."""
PAST_DURATION = 1.0
"""Duration (s) of the shared past in the picture."""


@dataclass(frozen=True)
class Branch:
    """One continuation of a run, with its changes as in `twin.robot.run.branch.branched_experiment`."""

    name: str
    settings: Sequence[str] = ()
    faults: Sequence[str] = ()
    body: str | None = None


@study(draws=True, isolated=True, before=[print_latest])
def branch(
    run: Annotated[Path, Argument("A run's folder, its recording, or results/EXPERIMENT.", "RUN")],
    say: Say,
    at: Annotated[float | None, Option("Time at which the branches leave the run.", "S", least=0.0)] = None,
    settings: Annotated[
        Sequence[str],
        Option("A branch with another value; several keys with ';'; may be repeated.", "KEY=VALUE", "--set"),
    ] = (),
    faults: Annotated[
        Sequence[str], Option("A branch with a fault, an inline table of TOML; may be repeated.", "TABLE", "--fault")
    ] = (),
    body: BodyName = None,
    out: Annotated[Path | None, Option("Folder; default: results/branches/EXPERIMENT.", "DIR")] = None,
) -> Result:
    """Continue a run from one moment in several ways, and compare them.

    Each --set, --fault and --body is a branch of its own. The branches start from
    the state at that moment: one saved in the recording, or one made by running
    again from the start, as for parts that cannot save their state.

    Exit code: 0 done, 2 input refused (a key that cannot change in mid-run), 3 a
    component failed.

    Example: twin branch results/fig4_force_position --at 6.2 --set plant.k_s_Nm_per_rad=0.8
    """
    from twin.kernel.atomic_write import make_folder
    from twin.kernel.recording.folder import recording_in
    from twin.robot.run.branch import branched_experiment
    from twin.robot.run.handover import BranchPoint
    from twin.robot.run.run import execute

    asked = [
        *(Branch(text, settings=text.split(";")) for text in settings),
        *(Branch(text, faults=[text]) for text in faults),
        *([Branch(f"body {body}", body=body)] if body is not None else []),
    ]
    if at is None or not asked:
        lacking = "--at SECONDS" if at is None else "a change: --set, --fault or --body"
        raise InputRefused(f"twin branch {run}: expected {lacking}")
    recording = recording_in(run).absolute()
    base = branched_experiment(recording)
    tick, period = base.cosim.tick, base.controller_ticks
    # changes take effect at a call of the controller
    start = period * round(at / (tick * period))
    if not 0 < start < base.duration_ticks:
        raise InputRefused(
            f"--at {at:g}: expected a time within the run, above 0 and below {base.duration_ticks * tick:g} s"
        )
    experiments = [branched_experiment(recording, one.settings, one.faults, one.body) for one in asked]
    if late := [fault for one in experiments for fault in one.faults[len(base.faults) :] if fault.onset < start]:
        raise InputRefused(f"--fault: onset at {late[0].onset * tick:g} s is before the branch at {start * tick:g} s")
    home = make_folder((out or RESULTS_FOLDER / base.name).absolute())
    say("restoring the branch point", 0.0)
    point = BranchPoint(base, recording, start)
    plan = [("as it was", base)]
    for one, experiment in zip(asked, experiments, strict=True):
        broken = experiment.faults[-1] if one.faults else None
        named = f"{broken.kind} of {broken.target} at {broken.onset * tick:g} s" if broken else one.name
        plan.append((named, experiment))
    runs: list[Run] = []
    forces: list[Force] = []
    for number, (name, experiment) in enumerate(plan):
        say(f"{name}, {number + 1} of {len(plan)}", number / len(plan))
        with point.hand_over(experiment) as state:
            runs.append(execute(experiment, home / f"{number}", state=state))
        forces.append(_read_force(runs[-1].recording))
    say("drawing", 1.0)
    names, before = [name for name, _ in plan], _read_force(recording, salvage=True)
    _draw(names, forces, before, start * tick, home / PICTURE_FILE)
    rows = [_row(name, done, force, forces[0]) for name, done, force in zip(names, runs, forces, strict=True)]
    return _result(base.name, run, runs, rows, start * tick, point, home)


def _read_force(recording: Path, salvage: bool = False) -> "Force":
    from twin.kernel.recording.reader import read

    found = read(recording, salvage=salvage)
    return found.time("plant"), -found["plant.F_ee_B"][:, 2]


def _row(name: str, run: "Run", force: "Force", own: "Force") -> dict[str, Any]:
    """Return the JSON values of a branch; it leaves the run where its force first differs from the run's `own`."""
    import numpy as np

    t, F_z = force
    left, k = np.flatnonzero(np.abs(F_z - own[1][: len(F_z)]) > MIN_DIFFERENCE), int(F_z.argmax())
    return {
        "branch": name,
        "recording": str(run.recording),
        "leaves_at": float(t[left[0]]) if len(left) else None,
        "peak": float(F_z[k]),
        "peak_time": float(t[k]),
        "end": run.outcome.end,
        "trip": run.trip,
    }


def _result(
    name: str,
    run: Path,
    runs: Sequence["Run"],
    rows: Sequence[dict[str, Any]],
    at: float,
    point: "BranchPoint",
    home: Path,
) -> Result:
    from twin.kernel.process.job import relative_path
    from twin.kernel.recording.reader import read
    from twin.robot.assembly.declared import DECLARED_TABLES
    from twin.robot.experiment.recorded import recorded_values
    from twin.studies.metrics.standing import compare_single_runs

    columns = [
        Column("branch", left=True),
        Column("leaves", form=".3f", unit="s", gap=3),
        Column("peak", form=".2f", unit="N", gap=3),
        Column("at", form=".3f", unit="s", gap=3),
        Column("end", form=".2f", unit="N", gap=3),
        Column(gap=3, left=True, folds=True),
    ]
    cells = []
    for number, row in enumerate(rows):
        leaves = math.nan if row["leaves_at"] is None else row["leaves_at"]
        cells.append((str(number), leaves, row["peak"], row["peak_time"], row["end"], row["trip"]))
    named = [note(str(number), row["branch"]) for number, row in enumerate(rows)]
    count = len(rows) - 1
    headline = f"{name}  {count} {'branch' if count == 1 else 'branches'} at {at:g} s, {point.how}"
    folders = " ".join(str(relative_path(home / str(number))) for number in range(len(rows)))
    after = note(
        "leaves",
        f"when the true force differs from the run's by more than {MIN_DIFFERENCE:g} N; end: mean of the last second",
    )
    lacking = [note("state", f"run again for each branch: {'; '.join(point.lacking)}")] if point.lacking else []
    measures = [one.outcome.measures for one in runs]
    values = [recorded_values(DECLARED_TABLES, read(one.recording).metadata, one.recording) for one in runs]
    compared = [
        compare_single_runs((str(number), "0"), (measures[number], measures[0]), (values[number], values[0]))
        for number in range(1, len(runs))
    ]
    facts = {"at": at, "verdict": compared, "state": point.how, "branches": rows}
    files = {"picture": relative_path(home / PICTURE_FILE), "next": f"twin report {run} {folders}"}
    body: list[Block] = [Table(columns, cells), *named, *(Note(text, later=2) for text in compared), *lacking, after]
    return Result(headline, body, facts, files)


def _draw(names: Sequence[str], forces: Sequence["Force"], past: "Force", at: float, path: Path) -> None:
    """Draw the true force of all branches of a run to `path`, with their shared past once."""
    from twin.studies.figure import BLUE, GREEN, INK, ORANGE, PINK, SKY, VERMILION, picture

    t, F_z = past
    with picture(path, 9.0, 4.2, f"True pressing force, branches at {at:g} s") as figure:
        axes = figure.subplots()
        before = (t >= at - PAST_DURATION) & (t <= at)
        axes.plot(t[before], F_z[before], color=INK, lw=1.6)
        colors = cycle((INK, BLUE, VERMILION, GREEN, ORANGE, PINK, SKY))
        for number, (name, force, color) in enumerate(zip(names, forces, colors, strict=False)):
            axes.plot(*force, color=color, lw=1.2 if number else 1.6, label=f"{number}  {name}"[:70])
        axes.axvline(at, color=INK, lw=0.8, ls=":")
        axes.set_xlabel("t (s)")
        axes.set_ylabel("F_z (N)")
        figure.legend(loc="outside lower center", fontsize=8)
