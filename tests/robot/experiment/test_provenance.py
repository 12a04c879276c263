"""Where the numbers of the shipped experiments come from: each says so, and none claims to have been read off a figure.

The paper's text prints N, k_s, eta, the sweep, the scale's height, 0.6 N, 5 N, 0.005 kg, 5.6 s and 13.7 s. No axis of
its figures is printed in it, and nobody here has a picture of them.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.source import Source, read_source

EXPERIMENTS = sorted((ROOT / "experiments").glob("*.toml"))
PARTS = sorted(path for folder in ("robots", "bodies") for path in (ROOT / "experiments" / folder).glob("*.toml"))
DESCRIBING = (
    "robot", "plant", "drive", "contact", "scale", "controller", "reference", "approach", "task", "monitor", "change",
)  # fmt: skip
"""Tables that describe robot, drive, body, controller or reference. All others are settings of the run."""
SETTINGS = re.compile(r"plant\.substeps|drive(\.joint_\d)?\.substeps|change\.\d+\.t_s|reference\.joint_step\.joint")
"""Numbers in these tables that are settings of the run all the same, or say which joint."""
KINDS = re.compile(r"assumed|tuned|derived|believed|Sec\. |Eq\. |[A-Z]\w+.* \(\d{4}\)")
"""How a source begins: what can be looked up, or who made the number and why."""


def numbers(values: Any, prefix: str = "") -> Iterator[str]:
    """Dotted keys of all numbers and arrays of numbers."""
    match values:
        case bool() | str() | None:
            return
        case dict():
            for key, value in values.items():
                yield from numbers(value, f"{prefix}{key}.")
        case tuple() if values and isinstance(values[0], dict):
            for number, item in enumerate(values, start=1):
                yield from numbers(item, f"{prefix}{number}.")
        case _:
            yield prefix.removesuffix(".")


def described(source: Source) -> dict[str, str]:
    """Dotted keys of the numbers that describe something, with their origins."""
    tables = {name: source.values[name] for name in DESCRIBING if name in source.values}
    return {key: source.origins.get(key, "") for key in numbers(tables) if not SETTINGS.fullmatch(key)}


def complete(path: Path) -> Source:
    """What an experiment says with all the files it stands on, and without what the robot's file fills in."""
    origins = load_experiment(path).origins
    source = read_source(path)
    if "body" in source.values.get("contact", {}):
        body = read_source(ROOT / f"experiments/bodies/{source.values['contact']['body']}.toml")
        source.values["contact"] = {**body.values["contact"], **source.values["contact"]}
    return Source(source.values, origins)


@pytest.mark.parametrize("path", [*EXPERIMENTS, *PARTS], ids=lambda path: path.stem)
def test_every_number_that_describes_something_has_a_source(path: Path):
    source = complete(path) if path in EXPERIMENTS else read_source(path)
    found = described(source)
    assert found
    assert [f"{key}: {origin!r}" for key, origin in found.items() if not KINDS.match(origin)] == []


def test_a_number_without_a_source_is_found(tmp_path: Path):
    (tmp_path / "bare.toml").write_text(
        f'extends = "{ROOT}/experiments/fig4_position.toml"\n[contact]\ntilt_deg = 1.0\n[reference]\nt_s = [0.0]\n'
    )
    found = described(read_source(tmp_path / "bare.toml"))
    assert [key for key, origin in found.items() if not KINDS.match(origin)] == ["contact.tilt_deg", "reference.t_s"]


# words that only somebody who has the picture could write
SEEN = re.compile(
    r"Fig\. 4 ?[A-D]('s| shows| reference)|size of Fig|line's width|20 s axis|30 mm axis|force curves show|"
    r"like the paper's|published experiment|fit Fig\. 4|tuned to Fig\. 4 [A-D]|as in Fig\. 4 [A-D]"
)


def test_nothing_claims_to_have_been_read_off_a_figure():
    files = [
        path
        for folder in ("experiments", "twin", "fmus", "docs")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in {".toml", ".py", ".md", ".c", ".mo", ".yml"} and "__pycache__" not in path.parts
    ]
    assert len(files) > 300
    assert [f"{path}: {found[0]}" for path in files if (found := SEEN.search(path.read_text(encoding="utf-8")))] == []
