"""An FMU as PythonFMU builds it by default: it states no units and needs an execution tool, which is Python."""

import json
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.command_line import twin
from tests.docs.code_blocks import blocks
from tests.kernel.fmi.archives import redescribed
from tests.kernel.fmi.test_component import made, run
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.description import described

pytestmark = pytest.mark.skipif(find_spec("pythonfmu") is None, reason="no pythonfmu: pip install .[fmus]")

SLAVE = '''
from math import pi

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String


class Rpm(Fmi2Slave):
    """A shaft that follows its command in rpm, slower by 10 rpm per N mm."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.speed_cmd = self.torque = self.speed = self.angle = 0.0
        self.steps, self.on, self.label = 0, True, "ä"
        for name in ("speed_cmd", "torque"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in ("speed", "angle"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))
        self.register_variable(Integer("steps", causality=Fmi2Causality.output))
        self.register_variable(Boolean("on", causality=Fmi2Causality.input))
        self.register_variable(String("label", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))

    def do_step(self, t, h):
        self.speed = self.on * self.speed_cmd - 10.0 * self.torque
        self.angle += h * self.speed * pi / 30.0
        self.steps += 1
        return True
'''
MAPPING: dict[str, Any] = {
    "inputs": {"omega_ref": "speed_cmd[rpm]", "tau_load": "torque[N.mm]"},
    "outputs": {"omega_m": "speed[rpm]", "theta_m": "angle[rad]"},
}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU of `pythonfmu build -f rpm.py`."""
    folder = tmp_path_factory.mktemp("pythonfmu")
    (folder / "rpm.py").write_text(SLAVE, encoding="utf-8")
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", "rpm.py"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "Rpm.fmu"


def test_it_runs_by_cosim_with_a_note_that_names_the_attribute_and_the_option(built: Path, tmp_path: Path):
    assert described(built).needs_tool and not any(v.unit for v in described(built).variables.values())
    words = ["--tick-ms", "10", "--stop-s", "1", "--set", "speed_cmd=30", "--out", "new/folders/run", "--json"]
    done = twin("cosim", built, *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["recording"] == "new/folders/run/run.mcap"
    (note,) = facts["forgiven"]
    assert "needsExecutionTool" in note and "--no-external-tool" in note
    exported = twin("export", facts["recording"], "--csv", cwd=tmp_path)
    assert exported.returncode == 0, exported.stderr
    head, *rows = next(tmp_path.rglob("*.csv")).read_text().splitlines()
    last = dict(zip(head.split(","), map(float, rows[-1].split(",")), strict=True))
    assert last["Rpm.speed"] == 30.0 and last["Rpm.steps"] == 100.0
    assert last["Rpm.angle"] == pytest.approx(np.pi, rel=1e-12)


def test_an_fmu_of_another_tool_that_needs_it_is_refused_without_lenient(built: Path, tmp_path: Path):
    other = redescribed(built, tmp_path / "other.fmu", 'generationTool="PythonFMU', 'generationTool="Other')
    with pytest.raises(InputRefused, match=r"needsExecutionTool.*--lenient"):
        described(other)
    assert described(other, lenient=True).needs_tool


def test_as_a_drive_its_units_are_those_of_the_mapping(built: Path):
    out = run(made(built, **MAPPING), np.pi, 1e-3, 100)
    # 30 rpm, less 10 rpm for 1 N mm
    assert out["omega_m"][-1] == pytest.approx(np.pi * 2.0 / 3.0, rel=1e-12)
    assert out["theta_m"][-1] == pytest.approx(0.1 * np.pi * 2.0 / 3.0, rel=1e-12)


def test_as_a_drive_a_load_in_an_unstated_unit_is_asked_for(built: Path, tmp_path: Path):
    shutil.copy(built, tmp_path / "Rpm.fmu")
    done = twin("drive", "check", "Rpm.fmu", cwd=tmp_path)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "speed_cmd" in done.stderr


@pytest.mark.slow
def test_the_drive_of_the_page_is_built_with_its_options_and_qualifies(root: Path, tmp_path: Path):
    page = blocks(root, "docs/make_a_drive.md")
    (slave,) = (block for block in page if block.language == "python")
    (build,) = (line for block in page for line in block.text.splitlines() if "-m pythonfmu build" in line)
    (printed,) = (block.text for block in page if "QUALIFIED" in block.text)
    (tmp_path / slave.file_name).write_text(slave.text)
    command = [sys.executable, *build.split()[1:]]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    done = twin("drive", "check", "Lag.fmu", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(printed)
    checks = [line.split()[:2] for line in done.stdout.splitlines() if line.startswith("  ok ")]
    assert [name for _, name in checks][-2:] == ["state", "written"]
