"""The map of the house names every room, and the contracts on imports leave none out."""

import tomllib
from pathlib import Path

import pytest

OWNERS = {"fmpy": {"drive"}, "control": {"studies"}, "mcap": {"recording"}}
"""Rooms that may import a package, where not all may."""


def rooms(folder: Path) -> set[str]:
    return {path.parent.name for path in folder.glob("*/__init__.py")}


@pytest.mark.parametrize("folder", ["twin", "twin/studies"])
def test_every_room_is_on_the_map(root: Path, folder: str):
    page = (root / "docs/how_it_works.md").read_text()
    assert {room for room in rooms(root / folder) if f"`{room}`" not in page and f"[`{room}`]" not in page} == set()


def test_there_are_no_more_than_fourteen_rooms(root: Path):
    assert len(rooms(root / "twin")) <= 14


@pytest.mark.parametrize("package", OWNERS)
def test_a_package_that_belongs_to_one_room_is_forbidden_to_every_other(root: Path, package: str):
    settings = tomllib.loads((root / "pyproject.toml").read_text())
    contracts = settings["tool"]["importlinter"]["contracts"]
    (contract,) = [one for one in contracts if one.get("forbidden_modules") == [package]]
    modules = {path.stem for path in (root / "twin").glob("*.py")} - {"__init__", "__main__"}
    named = {source.removeprefix("twin.") for source in contract["source_modules"]}
    assert named == (rooms(root / "twin") | modules) - OWNERS[package]
