"""Preparation of a system for a run: FMUs extracted, planned, coupled."""

import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from twin.kernel.atomic_write import make_folder, write_bytes
from twin.kernel.errors import TwinError
from twin.kernel.fmi.description import build_binary
from twin.kernel.ssp.flat import FlatSystem, flatten
from twin.kernel.ssp.package import Package
from twin.kernel.systems.additions import Additions, SystemNames, overruled_names, with_parameters, with_settings
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.coupling import PreparedSystem, couple_system, folders_of
from twin.kernel.systems.extras import SystemExtras
from twin.kernel.systems.fed_inputs import input_extras, table_extras
from twin.kernel.systems.plan import SystemPlan, fmu_sources, plan_system
from twin.kernel.systems.topics import topics


@contextmanager
def open_system(
    package: Package,
    choice: MasterChoice = MasterChoice(),  # noqa: B008, it is frozen
    compiled: bool = False,
    additions: Additions = Additions(),  # noqa: B008, it is frozen
    beside: SystemExtras = SystemExtras(),  # noqa: B008, likewise
) -> Iterator[tuple[SystemPlan, PreparedSystem]]:
    """Plan and couple a package's system, with `additions` and components `beside` FMUs; free it after the block.

    `compiled`: whether FMUs without a binary for this platform are built from source.
    """
    with scratch_folder(package) as scratch:
        plan = _make_plan(package, Path(scratch), choice, compiled, additions, beside)
        folders = folders_of(plan)
        # deleted before any binary is loaded, as a crash would leave the folder behind
        shutil.rmtree(scratch, ignore_errors=True)
        with couple_system(plan, folders) as made:
            yield made.plan, made


@contextmanager
def open_plan(package: Package, choice: MasterChoice, compiled: bool, additions: Additions) -> Iterator[SystemPlan]:
    """Yield the plan of a package's system while its extracted FMUs exist; arguments and errors as in `open_system`."""
    with scratch_folder(package) as scratch:
        yield _make_plan(package, Path(scratch), choice, compiled, additions, SystemExtras())


def _make_plan(
    package: Package, scratch: Path, choice: MasterChoice, compiled: bool, additions: Additions, beside: SystemExtras
) -> SystemPlan:
    package = with_parameters(package, additions.parameters)
    flat, tables = table_extras(package, flatten(package.structure, f"{package.file}"))
    files, names = extract_fmus(package, flat, scratch, compiled)
    if additions.settings or additions.inputs:
        flat = with_settings(flat, names, additions.settings)
        tables = tables + input_extras(names, additions.inputs, additions.settings)
    plan = plan_system(package, flat, files, choice, tables + beside, additions.recorded)
    plan = replace(plan, overruled=tuple(overruled_names(flat, names, additions)))
    # refuse names that a recording cannot store before the recording is created
    topics(plan)
    return plan


def extract_fmus(
    package: Package, flat: FlatSystem, scratch: Path, compiled: bool = False
) -> tuple[dict[str, Path], SystemNames]:
    """Extract a package's FMUs to the folder `scratch`; return (FMU files by entry, names of the system)."""
    files: dict[str, Path] = {}
    entries = fmu_sources(package, flat)
    for entry in entries.values():
        if entry not in files:
            files[entry] = scratch / entry
            make_folder(files[entry].parent)
            write_bytes(files[entry], package.content(entry))
            if compiled:
                build_binary(files[entry])
    return files, SystemNames(package, flat, {path: files[entry] for path, entry in entries.items()})


@contextmanager
def scratch_folder(package: Package) -> Iterator[str]:
    """Create a temporary folder for extracted files, deleted after the block; errors show the package's path."""
    scratch = tempfile.mkdtemp()
    try:
        yield scratch
    except TwinError as error:
        # replaced first, as it contains the path
        text = re.sub(rf"twin drive info {re.escape(scratch)}/\S+ --compile builds", "--compile builds", str(error))
        for entry, path in package.loose.items():
            text = text.replace(f"{scratch}/{entry}", str(path))
        error.args = (text.replace(f"{scratch}/", f"{package.file}: "),)
        raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
