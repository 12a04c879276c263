"""The packages that twin asks for, and those that are there."""

import platform
from importlib.metadata import PackageNotFoundError, metadata, version
from typing import Any

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from twin.cli.installation.finding import Finding
from twin.files import read_toml
from twin.places import HOME

PURPOSES = {
    "dask": "twin sweep --engine dask",
    "live": "twin run --live",
    "parquet": "twin export --parquet",
    "ros2": "logs of ROS 2 in twin compare, replay, identify and export",
}
"""What users need an extra for; all others are for who develops twin."""


def project_table() -> dict[str, Any]:
    """[project] of the clone's pyproject.toml; without one, what the installed package says in its place."""
    project = HOME / "pyproject.toml"
    return read_toml(project)["project"] if project.is_file() else installed_table()


def installed_table(package: str = "twin") -> dict[str, Any]:
    """Python, requirements and extras of the installed `package`, as pyproject.toml has them."""
    told = metadata(package)
    table: dict[str, Any] = {"requires-python": told["Requires-Python"], "dependencies": []}
    extras = table["optional-dependencies"] = {extra: [] for extra in told.get_all("Provides-Extra") or ()}
    for requirement in map(Requirement, told.get_all("Requires-Dist") or ()):
        marker, requirement.marker = requirement.marker, None
        if marker is None or marker.evaluate({"extra": ""}):
            table["dependencies"].append(str(requirement))
            continue
        for extra, texts in extras.items():
            if marker.evaluate({"extra": extra}):
                texts.append(str(requirement))
    return table


def package_findings(project: dict[str, Any], clone: bool = True) -> list[Finding]:
    """Python, the packages that are needed, and each extra.

    Args:
        project: as of `project_table`.
        clone: it is installed from one, so that pip can be told of it, and extras for developing are of interest.
    """
    return [_python(project["requires-python"]), _needed(project["dependencies"], clone), *_extras(project, clone)]


def _python(wanted: str) -> Finding:
    here = platform.python_version()
    fits = SpecifierSet(wanted).contains(here, prereleases=True)
    remedy = "" if fits else "; make the environment anew with another Python"
    return Finding("python", "ok" if fits else "bad", f"{here}, needs {wanted}{remedy}")


def _needed(texts: list[str], clone: bool) -> Finding:
    wrong = _problems(texts)
    if wrong:
        remedy = "pip install -c constraints.txt -e ." if clone else _install(wrong)
        return Finding("packages", "bad", f"{'; '.join(wrong.values())}: {remedy}")
    return Finding("packages", "ok", f"all {len(texts)} that are needed")


def _extras(project: dict[str, Any], clone: bool) -> list[Finding]:
    findings = []
    for extra, texts in project.get("optional-dependencies", {}).items():
        if not clone and extra not in PURPOSES:
            continue
        missing = _problems(texts)
        if not missing:
            findings.append(Finding(extra, "ok", "installed"))
            continue
        purpose = PURPOSES.get(extra, "developing twin")
        remedy = f"pip install -e '.[{extra}]'" if clone else _install(missing)
        text = f"{purpose} needs: {remedy} ({'; '.join(missing.values())})"
        findings.append(Finding(extra, "lacks" if extra in PURPOSES else "note", text))
    return findings


def _install(requirements: dict[str, str]) -> str:
    return "pip install " + " ".join(f"'{text}'" for text in requirements)


def _problems(texts: list[str]) -> dict[str, str]:
    """What is wrong, by the requirement that is not met."""
    return {text: problem for text in texts if (problem := _problem(text))}


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
