"""`twin doctor`: the state of this installation, with a remedy for each finding."""

import json
import os
import platform
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from twin import __version__
from twin.kernel.compiled.store import (
    FOLDER_VARIABLE,
    PACKAGED_OBJECTS,
    damaged_files,
    object_files,
    object_folder,
    refusal,
)
from twin.kernel.errors import InputRefused
from twin.kernel.files import read_toml
from twin.kernel.fmi.unpacked import cache_info
from twin.robot.paths import PACKAGE_FOLDER, PROJECT_FOLDER, is_clone
from twin.studies.command import Answer, Option, study
from twin.studies.qualify.drive_list import listed_drives
from twin.studies.result import wrap_text

# slow modules are imported where they are needed: most checks use cached information
State = Literal["ok", "note", "lacks", "bad"]
"""note: missing, but only developers of twin need it. lacks: twin runs, without a feature. bad: it does not run."""
EXTRA_PURPOSES = {
    "dask": "twin sweep --engine dask",
    "explore": "twin explore",
    "live": "twin run --live",
    "parquet": "twin export --parquet",
    "ros2": "logs of ROS 2 in twin compare, replay, identify and export",
    "shadow": "twin shadow with a running robot",
}
"""Purpose of each extra that users need; all others are for developers of twin."""
PRIVATE_FOLDER_TEXT = "which only you can write to"
DEFAULT_DRIVE = "velocity_servo"
LOW_DISK_BYTES, MIN_DISK_BYTES = 1e9, 1e8
"""Free disk space (bytes) below which the finding is "lacks" or "bad"; a recording of 20 s takes about 6 MB."""
SMOKE_EXPERIMENT = "fig4_force_position.toml"


class Finding(NamedTuple):
    """Result of one check of the installation; `text` includes a remedy if the state is not ok."""

    topic: str
    state: State
    text: str


def is_ready(findings: Sequence[Finding]) -> bool:
    return all(finding.state != "bad" for finding in findings)


def installed_table(package: str = "twin") -> dict[str, Any]:
    """Return Python version, requirements and extras of the installed `package`, in the form of pyproject.toml."""
    from importlib.metadata import metadata

    from packaging.requirements import Requirement

    distribution = metadata(package)
    table: dict[str, Any] = {"requires-python": distribution["Requires-Python"], "dependencies": []}
    extras = table["optional-dependencies"] = {extra: [] for extra in distribution.get_all("Provides-Extra") or ()}
    for requirement in map(Requirement, distribution.get_all("Requires-Dist") or ()):
        marker, requirement.marker = requirement.marker, None
        if marker is None or marker.evaluate({"extra": ""}):
            table["dependencies"].append(str(requirement))
            continue
        for extra, texts in extras.items():
            if marker.evaluate({"extra": extra}):
                texts.append(str(requirement))
    return table


def package_findings(project: dict[str, Any], clone: bool = True) -> list[Finding]:
    """Check Python, the required packages and each extra of `project`, the table of pyproject.toml.

    In a `clone`, pip can install twin again, and its user may develop twin.
    """
    from packaging.specifiers import SpecifierSet

    here, wanted, needed = platform.python_version(), project["requires-python"], project["dependencies"]
    fits = SpecifierSet(wanted).contains(here, prereleases=True)
    remedy = "" if fits else "; create the environment again with another Python"
    findings = [Finding("python", "ok" if fits else "bad", f"{here}, needs {wanted}{remedy}")]
    if wrong := _problems(needed):
        remedy = "pip install -c constraints.txt -e ." if clone else _install(wrong)
        findings.append(Finding("packages", "bad", f"{'; '.join(wrong.values())}: {remedy}"))
    else:
        findings.append(Finding("packages", "ok", f"all {len(needed)} that are needed"))
    for extra, texts in project.get("optional-dependencies", {}).items():
        if not clone and extra not in EXTRA_PURPOSES:
            continue
        missing = _problems(texts)
        if not missing:
            findings.append(Finding(extra, "ok", "installed"))
            continue
        purpose = EXTRA_PURPOSES.get(extra, "developing twin")
        remedy = f"pip install -e '.[{extra}]'" if clone else _install(missing)
        text = f"{purpose} needs: {remedy} ({'; '.join(missing.values())})"
        findings.append(Finding(extra, "lacks" if extra in EXTRA_PURPOSES else "note", text))
    return findings


def _install(requirements: dict[str, str]) -> str:
    return "pip install " + " ".join(f"'{text}'" for text in requirements)


def _problems(texts: list[str]) -> dict[str, str]:
    """Return requirement -> problem of all Python requirements that are not met."""
    return {text: problem for text in texts if (problem := _problem(text))}


def _problem(text: str) -> str:
    """Return the problem of the Python requirement `text`, such as "numpy>=2"; "" if it is met."""
    from importlib.metadata import PackageNotFoundError, version

    from packaging.requirements import Requirement

    wanted = Requirement(text)
    # an extra that contains another extra requires the project itself
    if wanted.name == "twin" or (wanted.marker and not wanted.marker.evaluate()):
        return ""
    try:
        there = version(wanted.name)
    except PackageNotFoundError:
        return f"{wanted.name} is not installed"
    fits = wanted.specifier.contains(there, prereleases=True)
    return "" if fits else f"{wanted.name} is {there}, not {wanted.specifier}"


def compiled_finding() -> Finding:
    """Check whether compiled code can be cached, exists, and is unmodified."""
    if refusal():
        return Finding("compiled", "lacks", f"every command compiles again: {refusal()}")
    why = f"as {FOLDER_VARIABLE} says" if os.environ.get(FOLDER_VARIABLE) else PRIVATE_FOLDER_TEXT
    place = f"{object_folder()}, {why}"
    files, brought = object_files(), object_files(PACKAGED_OBJECTS)
    if not files and not brought:
        return Finding("compiled", "ok", f"nothing yet: the first run compiles, some seconds; kept in {place}")
    text = f"{_size(files):.0f} MB kept in {place}{_damage_note(damaged_files([*brought, *files]), 'compiled again')}"
    return Finding("compiled", "ok", f"{_size(brought):.1f} MB came with twin; {text}" if brought else text)


def _size(files: Sequence[Path]) -> float:
    """Return the total size of files (MB)."""
    return sum(file.stat().st_size for file in files) / 1e6


def unpacked_finding() -> Finding:
    """Check whether FMUs can be unpacked, and whether the unpacked ones are unmodified."""
    try:
        drives_folder = cache_info()
    except InputRefused as refused:
        return Finding("unpacked", "bad", f"no drive can be unpacked: {refused}")
    damage = _damage_note(drives_folder.changed, "taken from the FMU again")
    place = f"{drives_folder.folder}, {PRIVATE_FOLDER_TEXT}{damage}"
    return Finding("unpacked", "ok", f"{drives_folder.drives} FMUs, {drives_folder.size / 1e6:.0f} MB, in {place}")


def _damage_note(damaged: Sequence[Path], remedy: str) -> str:
    if not damaged:
        return ""
    return f"; {len(damaged)} changed since ({damaged[0].name}), {remedy} when needed"


def home_finding(home: Path = PROJECT_FOLDER) -> Finding:
    """Check the folder where twin is installed, and that its experiments and drives exist."""
    topic, text = ("repository", str(home)) if is_clone() else ("installed", f"twin {__version__} in {PACKAGE_FOLDER}")
    missing = [name for name in ("experiments", "fmus", "tests/baselines") if not (home / name).is_dir()]
    if missing:
        return Finding(topic, "bad", f"{text}: {', '.join(missing)} missing; install it again")
    return Finding(topic, "ok", text)


def drives_finding(here: Path) -> Finding:
    """Check, without loading them, that the drives of fmus/ seen from `here` fit and have a binary for this machine."""
    try:
        drives = listed_drives(here)
    except InputRefused as refusal:
        return Finding("drives", "bad", str(refusal))
    wrong = [drive for drive in drives if drive.problem]
    if not drives:
        return Finding("drives", "lacks", "fmus/ is empty; the default drive is the one that comes with twin")
    if not wrong:
        return Finding("drives", "ok", f"all {len(drives)} of fmus/ fit, with binaries for this machine")
    text = f"{len(wrong)} of {len(drives)} do not fit: " + "; ".join(f"{d.name}: {d.problem}" for d in wrong)
    needed = DEFAULT_DRIVE in {drive.name for drive in wrong}
    return Finding("drives", "bad" if needed else "lacks", text)


def isolation_finding() -> Finding:
    """Check whether this machine can give a run its own process."""
    if os.name == "posix":
        text = "a run lives in a process of its own; a drive that crashes costs only its run"
        return Finding("isolation", "ok", text)
    return Finding("isolation", "lacks", "needs Linux or macOS: a drive that crashes takes twin with it")


def disk_finding(here: Path) -> Finding:
    """Check whether results/ in `here` is writable and has free space."""
    results = here / "results" if (here / "results").is_dir() else here
    if not os.access(results, os.W_OK):
        return Finding("disk", "bad", f"{results} cannot be written; run twin in a folder of yours, or use --out")
    free = shutil.disk_usage(results).free
    text = f"{free / 1e9:.1f} GB free in {results}"
    if free < LOW_DISK_BYTES:
        return Finding("disk", "bad" if free < MIN_DISK_BYTES else "lacks", f"{text}; delete old runs")
    return Finding("disk", "ok", text)


def smoke_finding(home: Path) -> Finding:
    """Check the installation by running one second of Fig. 4 with `twin run`."""
    import subprocess
    import tempfile
    import time

    from twin.kernel.process.process import environment, module_command

    with tempfile.TemporaryDirectory() as folder:
        command = module_command(
            "twin", "run", str(home / "experiments" / SMOKE_EXPERIMENT), "--json", "--set", "duration_s=1"
        )
        began = time.monotonic()
        done = subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True)
        taken = time.monotonic() - began
    if done.returncode:
        return Finding("run", "bad", done.stderr.strip() or f"twin run ended with exit code {done.returncode}")
    speed = json.loads(done.stdout)["real_time_factor"]
    return Finding("run", "ok", f"1 s of Fig. 4 in {taken:.1f} s with loading, {speed:.0f} x real time without")


def examine(here: Path, with_run: bool) -> list[Finding]:
    """Examine this installation for use in the folder `here`; `with_run`: include a test run."""
    home = home_finding()
    if home.state == "bad":
        return [home]
    project = PROJECT_FOLDER / "pyproject.toml"
    table = read_toml(project)["project"] if project.is_file() else installed_table()
    findings = [home, *package_findings(table, is_clone())]
    findings += [compiled_finding(), drives_finding(here), unpacked_finding(), isolation_finding()]
    findings.append(disk_finding(here))
    if is_clone():
        browser = shutil.which("chromium")
        findings.append(Finding("chromium", "ok" if browser else "note", browser or "the page's tests need it"))
    return [*findings, smoke_finding(PROJECT_FOLDER)] if with_run else findings


def verdict(findings: Sequence[Finding]) -> str:
    """Return the verdict on the installation: `ready`, `ready, without: live` or `not ready: packages`."""
    if not is_ready(findings):
        return "not ready: " + ", ".join(finding.topic for finding in findings if finding.state == "bad")
    without = [finding.topic for finding in findings if finding.state == "lacks"]
    return f"ready, without: {', '.join(without)}" if without else "ready"


def examination_text(findings: Sequence[Finding]) -> str:
    """Format the verdict on the installation and its findings, in at most 80 columns except for paths."""
    lines = [verdict(findings)]
    for finding in findings:
        lines += wrap_text(finding.text, f"  {finding.state:6} {finding.topic:10} ", whole=True)
    return "\n".join(lines)


@study()
def doctor(with_run: Annotated[bool, Option("Also run one second of Fig. 4.", flags="--run")] = False) -> Answer:
    """Check this installation, and report missing parts with their remedies.

    Exit code: 0 ready, even if something optional is missing, 2 not ready.

    Example: twin doctor
    """
    findings = examine(Path.cwd(), with_run)
    facts = {"verdict": verdict(findings), "findings": [finding._asdict() for finding in findings]}
    return Answer(examination_text(findings), facts, 0 if is_ready(findings) else InputRefused.exit_code)
