"""Readers of systems take work in proportion to the number of components, of each format."""

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from tests.growth import assert_linear_in_lines
from tests.kernel.systems.archives import archive, component, connection, structure, system
from twin.kernel.systems.reading import read_system


def maestro(folder: Path, fmu: Path, count: int) -> Path:
    names = [f"{{x}}.c{k}" for k in range(count)]
    wires = {f"{a}.omega_m": [f"{b}.omega_ref"] for a, b in pairwise(names)}
    file = folder / f"{count}.json"
    file.write_text(
        json.dumps(
            {"fmus": {"{x}": str(fmu)}, "connections": wires, "parameters": {f"{n}.theta_m": 0.0 for n in names}}
        )
    )
    return file


def osp(folder: Path, fmu: Path, count: int) -> Path:
    parts = "".join(f'<Simulator name="c{k}" source="{fmu}"/>' for k in range(count))
    wires = "".join(
        f'<VariableConnection><Variable simulator="c{k}" name="omega_m"/>'
        f'<Variable simulator="c{k + 1}" name="omega_ref"/></VariableConnection>'
        for k in range(count - 1)
    )
    home = folder / str(count)
    home.mkdir()
    file = home / "OspSystemStructure.xml"
    file.write_text(
        '<OspSystemStructure xmlns="http://opensimulationplatform.com/MSMI/OSPSystemStructure" version="0.1">'
        f"<Simulators>{parts}</Simulators><Connections>{wires}</Connections></OspSystemStructure>"
    )
    return file


def ssp(folder: Path, fmu: Path, count: int) -> Path:
    parts = [component(f"c{k}", "a.fmu") for k in range(count)]
    wires = [connection(f"c{k}.omega_m", f"c{k + 1}.omega_ref") for k in range(count - 1)]
    return archive(folder / f"{count}.ssp", structure(system(parts, wires), 0.1), {"a.fmu": fmu})


@pytest.mark.parametrize("written", [maestro, osp, ssp])
def test_a_system_of_twice_the_components_takes_twice_the_work(
    written: Callable[[Path, Path, int], Path], ideal: Path, tmp_path: Path
):
    few, many = (written(tmp_path, ideal, count) for count in (100, 200))
    assert_linear_in_lines(lambda: read_system(few), lambda: read_system(many), 2.0)
