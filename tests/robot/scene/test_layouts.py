"""The layouts in docs/layouts/ show what recordings hold, and all that they show is there."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from tests.report.page.test_followed_page import recorded_session
from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute

# a message path as Foxglove and Lichtblick write it: topic, field, index, function
MESSAGE_PATH = re.compile(r"/(?P<topic>[\w/]+)\.(?P<field>\w+)(\[(?P<index>\d+)\])?(\.@(?P<function>\w+))?")
# a curve as PlotJuggler names a number of a protobuf message in MCAP
CURVE = re.compile(r"/(?P<topic>[\w/]+)/(?P<field>\w+)(\[(?P<index>\d+)\])?")


@pytest.fixture(scope="module")
def pressing(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A massage task, which has a monitor, tasks and phases, and no scale."""
    experiment = load_experiment(root / "experiments/pressing.toml")
    return read(execute(experiment, tmp_path_factory.mktemp("pressing")).recording)


@pytest.fixture(scope="module")
def foxglove(root: Path) -> dict[str, Any]:
    return json.loads((root / "docs/layouts/twin_foxglove.json").read_text())


def shown(recording: Recording, path: str, form: re.Pattern[str]) -> bool:
    """Whether `path` leads to a number in `recording`."""
    found = form.fullmatch(path)
    assert found is not None, path
    field = recording.fields().get(f"{found['topic']}.{found['field']}")
    # a field of several values needs an index, one of a single value has none
    return field is not None and (int(found["index"]) < field.size if found["index"] else field.size == 1)


def panels(layout: str | dict[str, Any]) -> Iterator[str]:
    """Panels of a tree of splits, in order."""
    if isinstance(layout, str):
        yield layout
    else:
        yield from panels(layout["first"])
        yield from panels(layout["second"])


def test_every_path_of_the_foxglove_layout_leads_to_a_number_of_some_recording(
    foxglove: dict[str, Any], force_position: Recording, pressing: Recording
):
    paths = [path["value"] for config in foxglove["configById"].values() for path in config.get("paths", ())]
    assert len(paths) > 20
    for path in paths:
        assert shown(force_position, path, MESSAGE_PATH) or shown(pressing, path, MESSAGE_PATH), path


def test_the_layout_of_a_session_shows_what_a_session_with_a_fleet_has_and_the_button(root: Path, tmp_path: Path):
    layout = json.loads((root / "docs/layouts/twin_shadow_foxglove.json").read_text())
    paths = [path["value"] for config in layout["configById"].values() for path in config.get("paths", ())]
    session = read(recorded_session(tmp_path))
    assert len(paths) > 10
    assert [path for path in paths if not shown(session, path, MESSAGE_PATH)] == []
    placed = list(panels(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])
    assert {panel.split("!")[0] for panel in placed} == {"3D", "Plot", "Parameters", "RosOut"}


def test_the_only_function_of_the_foxglove_layout_makes_pressing_positive(foxglove: dict[str, Any]):
    paths = [path["value"] for config in foxglove["configById"].values() for path in config.get("paths", ())]
    turned = [path for path in paths if "@" in path]
    assert turned == ["/plant.F_ee_B[2].@negative", "/estimator.F_ee_B[2].@negative"]


def test_the_foxglove_layout_shows_the_pictures_and_the_events(foxglove: dict[str, Any]):
    configs = foxglove["configById"]
    assert {topic for topic, shown in configs["3D!robot"]["topics"].items() if shown["visible"]} == {"/scene", "/force"}
    assert configs["3D!robot"]["followTf"] == "base"
    assert configs["RosOut!events"]["topicToRender"] == "/events"


def test_every_panel_of_the_foxglove_layout_has_its_place(foxglove: dict[str, Any]):
    placed = list(panels(foxglove["layout"]))
    assert sorted(placed) == sorted(foxglove["configById"])
    assert {panel.split("!")[0] for panel in placed} == {"3D", "Plot", "StateTransitions", "RosOut"}


def test_every_curve_of_the_plotjuggler_layout_is_in_every_recording(
    root: Path, force_position: Recording, pressing: Recording
):
    layout = ElementTree.parse(root / "docs/layouts/twin_plotjuggler.xml")
    curves = [curve.attrib["name"] for curve in layout.iter("curve")]
    assert len(curves) > 20
    for curve in curves:
        assert shown(force_position, curve, CURVE) and shown(pressing, curve, CURVE), curve


def test_the_plotjuggler_layout_counts_its_plots_right(root: Path):
    layout = ElementTree.parse(root / "docs/layouts/twin_plotjuggler.xml")
    for splitter in layout.iter("DockSplitter"):
        areas = splitter.findall("DockArea")
        assert int(splitter.attrib["count"]) == len(areas) == len(splitter.attrib["sizes"].split(";"))
        assert all(area.find("plot") is not None for area in areas)
