"""Systems made ready to be run: FMUs taken out of their archive, planned, coupled."""

import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from twin.kernel.errors import TwinError
from twin.kernel.fmi.description import build
from twin.kernel.ssp.flat import FlatSystem, flattened
from twin.kernel.ssp.package import Package
from twin.kernel.systems.additions import Additions, SystemNames, overruled, with_parameters, with_settings
from twin.kernel.systems.beside import Beside
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.coupling import PreparedSystem, coupled, folders_of
from twin.kernel.systems.fed_inputs import inputs_beside, tables_beside
from twin.kernel.systems.plan import SystemPlan, fmu_sources, planned
from twin.kernel.systems.topics import topics
from twin.kernel.writing import made_folder, write_bytes


@contextmanager
def opened(
    package: Package,
    choice: MasterChoice = MasterChoice(),  # noqa: B008, it is frozen
    compiled: bool = False,
    additions: Additions = Additions(),  # noqa: B008, it is frozen
    beside: Beside = Beside(),  # noqa: B008, likewise
) -> Iterator[tuple[SystemPlan, PreparedSystem]]:
    """The system of a package, planned and ready to be run.

    Args:
        package: of the system.
        choice: what is asked of the master.
        compiled: whether FMUs without a binary for this machine are built from their sources.
        additions: values, inputs over time, and what is recorded.
        beside: what takes part beside its FMUs and what `additions` add.

    Raises:
        InputRefused: the system cannot be run.
    """
    with at_hand(package) as scratch:
        try:
            plan = _planned(package, Path(scratch), choice, compiled, additions, beside)
            folders = folders_of(plan)
        finally:
            # before anything is loaded: what crashes would leave it
            shutil.rmtree(scratch, ignore_errors=True)
        with coupled(plan, folders) as made:
            yield made.plan, made


@contextmanager
def drawn_up(package: Package, choice: MasterChoice, compiled: bool, additions: Additions) -> Iterator[SystemPlan]:
    """The plan of a package, as long as its FMUs are there; arguments and refusals as of `opened`."""
    with at_hand(package) as scratch:
        try:
            yield _planned(package, Path(scratch), choice, compiled, additions, Beside())
        finally:
            shutil.rmtree(scratch, ignore_errors=True)


def _planned(
    package: Package, scratch: Path, choice: MasterChoice, compiled: bool, additions: Additions, beside: Beside
) -> SystemPlan:
    package = with_parameters(package, additions.parameters)
    flat, tables = tables_beside(package, flattened(package.structure, f"{package.file}"))
    files, names = taken_out(package, flat, scratch, compiled)
    if additions.settings or additions.inputs:
        flat = with_settings(flat, names, additions.settings)
        tables = tables + inputs_beside(names, additions.inputs, additions.settings)
    plan = planned(package, flat, files, choice, tables + beside, additions.recorded)
    plan = replace(plan, overruled=tuple(overruled(flat, names, additions)))
    # refuses names that a recording cannot hold, before there is one
    topics(plan)
    return plan


def taken_out(
    package: Package, flat: FlatSystem, scratch: Path, compiled: bool = False
) -> tuple[dict[str, Path], SystemNames]:
    """The FMUs of a system in `scratch`, by entry, and what names in it mean; `compiled` as of `opened`.

    Raises:
        InputRefused: a component is no FMU of the archive, or cannot be compiled.
    """
    files: dict[str, Path] = {}
    entries = fmu_sources(package, flat)
    for entry in entries.values():
        if entry not in files:
            files[entry] = scratch / entry
            made_folder(files[entry].parent)
            write_bytes(files[entry], package.content(entry))
            if compiled:
                build(files[entry])
    return files, SystemNames(package, flat, {path: files[entry] for path, entry in entries.items()})


@contextmanager
def at_hand(package: Package) -> Iterator[str]:
    """A folder for files of the archive; sentences of the block that tell of it tell of the archive instead."""
    scratch = tempfile.mkdtemp()
    try:
        yield scratch
    except TwinError as error:
        # how to build a file that the archive holds
        text = re.sub(rf"twin drive info {re.escape(scratch)}/\S+ --compile builds", "--compile builds", str(error))
        for entry, path in package.loose.items():
            text = text.replace(f"{scratch}/{entry}", str(path))
        error.args = (text.replace(f"{scratch}/", f"{package.file}: "),)
        raise
