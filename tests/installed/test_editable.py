"""An editable install is the repository's path, which any Python finds, also where folders have the same names."""

from pathlib import Path

import pytest

from tests.installed.environments import Environment, built, installed

WHERE = "import twin, twin.robot.paths; print(twin.__file__); print(twin.robot.paths.is_clone())"

pytestmark = pytest.mark.skipif("sys.platform == 'win32'", reason="programs of an environment lie elsewhere there")


@pytest.fixture(scope="module")
def editable(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    folder = tmp_path_factory.mktemp("editable")
    return installed(built(root, "build_editable", folder), folder / "environment")


@pytest.mark.slow
def test_in_the_parent_of_a_clone_called_twin_the_package_is_found(root: Path, editable: Environment, tmp_path: Path):
    # what Python sees of a clone there: a folder without __init__.py
    (tmp_path / "twin" / "experiments").mkdir(parents=True)
    assert editable.run("python", "-c", WHERE, cwd=tmp_path).split() == [f"{root}/twin/__init__.py", "True"]
    assert editable.run("twin", "--version", cwd=tmp_path).startswith("twin ")


def test_it_is_a_plain_path(root: Path, editable: Environment):
    (packages,) = editable.folder.glob("lib/*/site-packages")
    (path,) = [file for file in packages.glob("*.pth") if file.name != "elsewhere.pth"]
    assert path.read_text().split() == [str(root)]
