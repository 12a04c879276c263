"""A wheel with machine code in it: all that runs need is there, in every form of the processor; nothing compiles."""

import json
import os
import platform
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from build_wheel import main, roots
from hatch_build import OBJECTS
from tests.bytes.cases import all_cases
from tests.installed.environments import BUILD, Environment, installed
from twin.kernel.compiled.machine import X86_64, chosen_form, object_name
from twin.kernel.compiled.store import seal

LINUX = pytest.mark.skipif(
    (sys.platform, platform.machine()) != ("linux", "x86_64"), reason="the wheel is for Linux on x86-64"
)
USED = """
import json, os, sys, tempfile
from pathlib import Path
sys.modules.update({name: None for name in sys.argv[1:]})
import twin
from twin.kernel.compiled import machine
from twin.kernel.errors import TwinError
for case in json.load(sys.stdin):
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for name, text in case["files"].items():
            Path(name).write_text(text)
        try:
            twin.run(twin.load(*case["load"]), "run")
        except TwinError as trip_or_failure:
            print(case["name"], trip_or_failure)
        os.chdir("/")
print(json.dumps(sorted(name for name in machine._loaded if name.startswith("twin."))))
"""
"""Runs cases; prints the functions whose machine code was loaded. Arguments: modules that cannot be imported."""


def cases(root: Path) -> list[dict[str, Any]]:
    """Runs of each experiment but the longest, and of one with each drive, kind of fault and variant."""
    loaded = [case for case in all_cases(root) if case.quick and case.load]
    chosen = [c for c in loaded if c.name.startswith(("run", "fault", "variant")) and c.name != "run calibration"]
    assert len(chosen) > 60
    return [asdict(case) for case in chosen]


@pytest.mark.slow
def test_the_wheel_has_every_function_that_runs_use(root: Path):
    done = subprocess.run([sys.executable, "-c", USED], input=json.dumps(cases(root)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    used, known = set(json.loads(done.stdout.splitlines()[-1])), {native.name for native in roots()}
    assert len(used) > 30 and used <= known


def test_machine_code_makes_it_a_wheel_for_one_platform(root: Path, tmp_path: Path):
    objects = tmp_path / "objects"
    objects.mkdir()
    (objects / "twin.a.o").write_bytes(seal("twin.a.o", b"code"))
    command = [sys.executable, "-c", BUILD, "build_wheel", str(tmp_path)]
    subprocess.run(command, cwd=root, env={**os.environ, OBJECTS: str(objects)}, capture_output=True, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.name == "twin-1.0.0-py3-none-linux_x86_64.whl"
    inside = zipfile.ZipFile(wheel)
    assert inside.read("twin/kernel/compiled/objects/twin.a.o") == (objects / "twin.a.o").read_bytes()
    assert "Root-Is-Purelib: false" in inside.read("twin-1.0.0.dist-info/WHEEL").decode()


@pytest.fixture(scope="module")
def carrying(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Environment]:
    folder = tmp_path_factory.mktemp("carrying")
    assert main(str(folder)) == 0
    (wheel,) = folder.glob("*.whl")
    yield installed(wheel, folder / "environment")


@LINUX
@pytest.mark.endurance
def test_nothing_is_compiled_after_the_wheel_is_installed(carrying: Environment, root: Path, tmp_path: Path):
    carried = {path.name for path in carrying.folder.rglob("compiled/objects/*.o")}
    assert carried == {object_name(native.name, form) for native in roots() for form in X86_64}
    for form in X86_64[: X86_64.index(chosen_form()) + 1]:
        asked = cases(root) if form is chosen_form() else cases(root)[:1]
        environment = {**os.environ, "TWIN_PROCESSOR": form.name, "TWIN_CACHE": str(tmp_path)}
        environment.pop("NUMBA_CACHE_DIR", None)
        done = subprocess.run(
            [carrying.folder / "bin" / "python", "-c", USED, "numba"],
            input=json.dumps(asked), env=environment, cwd=tmp_path, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert not list(carrying.folder.rglob("native/*.o"))


@LINUX
@pytest.mark.endurance
def test_code_of_the_wheel_that_was_damaged_is_compiled(carrying: Environment, tmp_path: Path):
    for path in carrying.folder.rglob("compiled/objects/*_angles-*.o"):
        path.write_bytes(path.read_bytes()[1:])
    carrying.run("twin", "run", "step_z_air", cwd=tmp_path)
    assert [path.name.partition("-")[0] for path in carrying.folder.rglob("native/*.o")] == [
        "twin.robot.mechanism.kinematics._angles"
    ]
