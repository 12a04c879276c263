"""How a file becomes an experiment that the robot can carry out."""

from collections.abc import Iterable
from pathlib import Path

from twin.errors import InputRefused
from twin.experiment.body_files import replace_body
from twin.experiment.drive_files import shelved
from twin.experiment.experiment import Experiment
from twin.experiment.mistakes import unit_hints
from twin.experiment.named import experiment_file
from twin.experiment.source import Source, override, read_source, refuse_other_files, replace_drive
from twin.experiment.tables import checked_tables, experiment_of
from twin.runs.assembly.checks.agreement import disagreements
from twin.runs.assembly.declared import DECLARED
from twin.runs.assembly.way_points import led

OUT_OF_REACH = "out of reach"
"""What every sentence on a pose has in it where the robot cannot be."""


def load_experiment(
    path: str | Path, overrides: Iterable[str] = (), drive: str | None = None, body: str | None = None
) -> Experiment:
    """Read, merge and check the experiment at `path`.

    Args:
        path: a TOML file, or the name of an experiment, see `experiment_file`.
        overrides: "table.key=value" texts laid over it; of an array of tables "task.1.force_N=4".
        drive: an FMU or a drive of fmus/ that replaces the drive of every joint and its parameters.
        body: a file of bodies/ that replaces all of [contact] but its height.

    Raises:
        InputRefused: with every mistake, one sentence each.
    """
    path = experiment_file(path)
    source = read_source(path)
    refuse_other_files(source.values, path)
    folder = path.resolve().parent
    if drive is not None:
        replace_drive(source, shelved(drive, folder))
    if body is not None:
        replace_body(source, body)
    override(source, overrides)
    return checked_experiment(source, path.stem, path, folder)


def checked_experiment(source: Source, name: str, where: Path, folder: Path) -> Experiment:
    """The experiment that `source` says, which is completed in place.

    Args:
        source: of all files.
        name: of the experiment.
        where: it comes from, for sentences.
        folder: from which bodies and drives are looked up.

    Raises:
        InputRefused: with every mistake, one sentence each.
    """
    mistakes: list[str] = []
    tables = checked_tables(DECLARED, source, folder, mistakes)
    reference = led(tables, mistakes)
    apart = disagreements(tables, reference, source.values)
    if any(OUT_OF_REACH in mistake for mistake in apart):
        mistakes += unit_hints(source.values)
    mistakes += apart
    if mistakes:
        several = f"{where} has {len(mistakes)} mistakes:" + "".join(f"\n  {mistake}" for mistake in mistakes)
        raise InputRefused(f"{where}: {mistakes[0]}" if len(mistakes) == 1 else several)
    return experiment_of(name, tables, reference, source)
