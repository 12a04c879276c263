"""FMPy's slaves, loaded quickly."""

from pathlib import Path

import pytest
from fmpy import fmi2, fmi3

from twin.drive.description import described
from twin.drive.lifecycle import CosimInstance, FMU2Drive, FMU3Drive
from twin.drive.unpacked import unpacked


@pytest.mark.parametrize(
    ("drive", "fmpy_slave", "slave"),
    [("velocity_servo", fmi2.FMU2Slave, FMU2Drive), ("torque_motor_fmi3", fmi3.FMU3Slave, FMU3Drive)],
)
def test_the_functions_of_a_second_slave_are_its_own_binarys_with_fmpys_signatures(
    root: Path, drive: str, fmpy_slave: type, slave: type, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("twin.drive.lifecycle._complete", set())
    fmu = described(root / "fmus" / drive / f"{drive}.fmu")
    folder = str(unpacked(fmu.path, fmu.sha256))
    said = {"guid": fmu.model.guid, "unzipDirectory": folder, "modelIdentifier": fmu.identifier}
    model, first, second = (made(instanceName="drive_1", **said) for made in (fmpy_slave, slave, slave))
    assert first._functions.keys() == model._functions.keys() and len(first._functions) > 20
    # which have to be there is known by now
    assert not second._functions
    for mine in (first, second):
        for name, known in model._functions.items():
            function = mine._functions[name]
            assert (function.argtypes, function.restype) == (known.argtypes, known.restype), name
            assert function is getattr(mine.dll, name)


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs Linux to see what is loaded")
def test_static_memory_of_a_binary_ends_with_its_last_instance(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path / "cache"))
    # unpacked where no other test has it loaded from
    fmu = described(root / "fmus" / "velocity_servo" / "velocity_servo.fmu")
    folder = unpacked(fmu.path, fmu.sha256)
    instances = [CosimInstance(f"drive_{joint}", fmu, folder) for joint in (1, 2, 3)]
    assert str(folder) in Path("/proc/self/maps").read_text()
    for instance in instances:
        instance.close()
    assert str(folder) not in Path("/proc/self/maps").read_text()
