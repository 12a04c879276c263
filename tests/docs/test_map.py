"""The map of the house names every room, and the contracts on imports leave none out."""

import inspect
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.map_rows import PAGE, completed, rows
from twin.cli.catalogue import command_texts
from twin.kernel.process.job import load_function

OWNERS = {
    "fmpy": "twin.kernel.fmi.**",
    "control": "twin.studies.analyse.linear.**",
    "mcap": "twin.kernel.recording.**",
    "numba": "twin.kernel.compiled.**",
}
"""The modules that may import a package, where not all may."""


def folders(root: Path) -> set[str]:
    """Folders of twin/ with modules, those of kernel and robot apart."""
    parts = {path.parent for path in (root / "twin").glob("*/__init__.py")}
    inner = {path.parent for part in ("kernel", "robot") for path in (root / "twin" / part).glob("*/__init__.py")}
    split = {root / "twin/kernel", root / "twin/robot"}
    return {path.relative_to(root).as_posix() for path in (parts | inner) - split}


def the_map(root: Path) -> str:
    return (root / "docs/how_it_works.md").read_text().partition("## Where the parts are")[2]


def test_every_folder_is_on_the_map_and_what_is_there_exists(root: Path):
    named = re.findall(r"`(twin/[\w/.]+)`", the_map(root))
    assert [place for place in named if not (root / place).exists()] == []
    assert folders(root) <= set(named)


def test_the_map_has_every_study_with_its_commands_as_the_files_have_them():
    page = PAGE.read_text()
    assert completed(page) == page
    lines = [line for line in page.splitlines() if line.startswith("| `sweep` | `sweep run` |")]
    assert len(lines) == 1 and completed(page.replace(lines[0] + "\n", "")) == page
    assert {words for cells, _ in rows().values() for words in re.findall("`(.*?)`", cells)} == set(command_texts())


def test_at_most_ten_folders_and_modules_are_at_the_top(root: Path):
    top = {path.stem for path in (root / "twin").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert top - {"__init__", "__main__"} == {"cli", "report", "studies", "robot", "kernel"}


@pytest.mark.parametrize("package", OWNERS)
def test_a_package_that_belongs_to_one_place_is_forbidden_to_every_other(root: Path, package: str):
    settings = tomllib.loads((root / "pyproject.toml").read_text())
    contracts = settings["tool"]["importlinter"]["contracts"]
    (contract,) = [one for one in contracts if one.get("forbidden_modules") == [package]]
    assert contract["source_modules"] == ["twin"]
    assert contract["ignore_imports"] == [f"{OWNERS[package]} -> {package}"]


def floors(root: Path) -> list[set[str]]:
    """Rooms from the top down."""
    settings = tomllib.loads((root / "pyproject.toml").read_text())
    contract = settings["tool"]["importlinter"]["contracts"][0]
    return [{room.strip().removeprefix("twin.") for room in re.split(r"[|:]", layer)} for layer in contract["layers"]]


def named_functions(root: Path) -> Iterator[tuple[Path, str]]:
    """(file, function it names in a text), "module:function"."""
    for path in (root / "twin").rglob("*.py"):
        for name in re.findall(r'"(twin(?:\.\w+)+:\w+)"', path.read_text()):
            yield path.relative_to(root / "twin"), name


def test_functions_that_are_named_in_a_text_exist_and_lie_on_no_higher_floor(root: Path):
    found = list(named_functions(root))
    # those of the guard, of the commands and of the public names
    assert len(found) > 20
    height = {room: number for number, floor in enumerate(floors(root)) for room in floor}
    for path, name in found:
        assert callable(load_function(name)), name
        # the package itself stands above all of its rooms
        if len(path.parts) > 1:
            assert height[path.parts[0]] <= height[name.split(".")[1]], f"{path}: {name}"


def test_a_study_in_a_process_of_its_own_tells_what_it_is_doing():
    for one in command_texts().values():
        function = load_function(f"{one.module}:{one.function}")
        if vars(function)["study"].isolated:
            assert {"say", "reporter"} & set(inspect.signature(function).parameters), one
