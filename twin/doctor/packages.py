"""The packages that pyproject.toml asks for, and those that are there."""

import platform
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from twin.doctor.finding import Finding

PURPOSES = {"dask": "twin sweep --engine dask", "live": "twin run --live", "parquet": "twin export --parquet"}
"""What users need an extra for; all others are for who develops twin."""


def project_table(checkout: Path) -> dict[str, Any] | None:
    """[project] of the pyproject.toml in `checkout`; None: there is none."""
    try:
        return tomllib.loads((checkout / "pyproject.toml").read_text())["project"]
    except FileNotFoundError:
        return None


def package_findings(project: dict[str, Any]) -> list[Finding]:
    """Python, the packages that are needed, and each extra.

    Args:
        project: the table of `project_table`.
    """
    return [_python(project["requires-python"]), _needed(project["dependencies"]), *_extras(project)]


def _python(wanted: str) -> Finding:
    here = platform.python_version()
    fits = SpecifierSet(wanted).contains(here, prereleases=True)
    remedy = "" if fits else "; make the environment anew with another Python"
    return Finding("python", "ok" if fits else "bad", f"{here}, needs {wanted}{remedy}")


def _needed(texts: list[str]) -> Finding:
    wrong = list(filter(None, map(_problem, texts)))
    if wrong:
        return Finding("packages", "bad", f"{'; '.join(wrong)}: pip install -c constraints.txt -e .")
    return Finding("packages", "ok", f"all {len(texts)} that are needed")


def _extras(project: dict[str, Any]) -> list[Finding]:
    findings = []
    for extra, texts in project.get("optional-dependencies", {}).items():
        missing = list(filter(None, map(_problem, texts)))
        if not missing:
            findings.append(Finding(extra, "ok", "installed"))
            continue
        purpose = PURPOSES.get(extra, "developing twin")
        text = f"{purpose} needs: pip install -e '.[{extra}]' ({'; '.join(missing)})"
        findings.append(Finding(extra, "lacks" if extra in PURPOSES else "note", text))
    return findings


def _problem(text: str) -> str:
    """What is wrong with what the requirement `text` asks for; "" if nothing is."""
    wanted = Requirement(text)
    # an extra that contains another one has the project itself as a requirement
    if wanted.name == "twin" or (wanted.marker and not wanted.marker.evaluate()):
        return ""
    try:
        there = version(wanted.name)
    except PackageNotFoundError:
        return f"{wanted.name} is not installed"
    return (
        ""
        if wanted.specifier.contains(there, prereleases=True)
        else f"{wanted.name} is {there}, not {wanted.specifier}"
    )
