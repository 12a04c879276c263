"""What the package's metadata says is true: what it imports, its version, its license."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from twin import __version__
from twin.cli.installation import EXTRA_PURPOSES


@pytest.fixture
def project(root: Path) -> dict[str, Any]:
    return tomllib.loads((root / "pyproject.toml").read_text())["project"]


def imported(package: Path) -> set[str]:
    """Names of the modules from elsewhere that any file of `package` imports, at its top or inside a function."""
    found: set[str] = set()
    for file in package.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {package.name}


@pytest.mark.slow
def test_every_package_that_is_imported_is_declared(root: Path, project: dict[str, Any]):
    extras = [text for extra in EXTRA_PURPOSES for text in project["optional-dependencies"][extra]]
    declared = {canonicalize_name(Requirement(text).name) for text in project["dependencies"] + extras}
    there = packages_distributions()
    undeclared = {
        module
        for module in imported(root / "twin")
        if not declared & {canonicalize_name(name) for name in there.get(module, [module])}
    }
    assert undeclared == set()


def test_every_declared_package_has_a_tested_version(root: Path, project: dict[str, Any]):
    pins = {
        canonicalize_name(Requirement(line).name) for line in (root / "constraints.txt").read_text().splitlines()[1:]
    }
    texts = [*project["dependencies"], *(text for extra in project["optional-dependencies"].values() for text in extra)]
    assert {canonicalize_name(Requirement(text).name) for text in texts} - pins == {"twin"}


def test_version_and_license_are_the_same_wherever_they_stand(root: Path, project: dict[str, Any]):
    citation = yaml.safe_load((root / "CITATION.cff").read_text())
    assert project["version"] == citation["version"] == __version__
    assert project["license"] == citation["license"] == "BSD-3-Clause"
    assert (root / "LICENSE").read_text().startswith("BSD 3-Clause License\n")
    assert project["authors"][0]["name"] == citation["authors"][0]["name"] == "the twin contributors"


def test_the_paper_is_cited_as_the_readme_cites_it(root: Path):
    (paper,) = yaml.safe_load((root / "CITATION.cff").read_text())["references"]
    authors = ", ".join(f"{person['given-names']} {person['family-names']}" for person in paper["authors"])
    readme = re.sub(r"\s+", " ", (root / "README.md").read_text())
    assert f"{authors}: *{paper['title']}*, {paper['year']}, {paper['identifiers'][0]['value']}." in readme
