"""What programs of others build on."""

import ast
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import twin

HEAVY = ("numba", "numpy", "scipy", "pydantic", "fmpy", "mcap", "matplotlib", "control")


def test_importing_the_package_loads_nothing_heavy():
    code = f"import sys, twin; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("name", twin.__all__)
def test_every_public_name_is_there_and_on_its_page(root: Path, name: str):
    assert getattr(twin, name) is not None
    assert name in dir(twin)
    assert f"`twin.{name}" in (root / "docs/python.md").read_text()


@pytest.mark.parametrize("name", twin.__all__)
def test_every_public_name_is_known_to_type_checkers(root: Path, name: str):
    stub = ast.parse((root / "twin/__init__.pyi").read_text())
    # of imports only `x as x` is handed on
    imported = {a.name for s in stub.body if isinstance(s, ast.ImportFrom) for a in s.names if a.name == a.asname}
    assigned = {ast.unparse(target) for s in stub.body if isinstance(s, ast.Assign) for target in s.targets}
    assert name in imported | assigned


def test_what_is_not_public_is_not_there():
    with pytest.raises(AttributeError, match="module 'twin' has no attribute 'load_experiment'"):
        _ = twin.load_experiment  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", [name for name in twin.__all__ if name.islower()])
def test_the_changelog_has_every_signature_as_it_is(root: Path, name: str):
    """Whoever changes one has to write it there."""
    log = " ".join((root / "CHANGELOG.md").read_text().split())
    parameters = ", ".join(inspect.signature(getattr(twin, name)).parameters)
    # the newest stands first
    newest, *_ = re.findall(rf"`twin\.{name}\(([^)]*)\)`", log)
    assert newest == parameters
