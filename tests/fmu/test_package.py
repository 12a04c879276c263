"""The .fmu files as files: fresh, valid, complete, reproducible."""

import subprocess
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from builder.archive import write_fmu
from builder.compile import TARGETS, universal_binary
from builder.drive import load_drive
from builder.model_description import model_description
from fmpy.validation import validate_fmu

from .rig import DRIVES, described, fmu_path

# first bytes of the libraries: ELF; DOS stub of a PE file; Mach-O universal binary
MAGIC = {"linux64": b"\x7fELF", "win64": b"MZ", "darwin64": b"\xca\xfe\xba\xbe"}

of_every_drive = pytest.mark.parametrize("drive", DRIVES)


@of_every_drive
def test_every_drive_folder_has_its_fmu(drive: str) -> None:
    assert fmu_path(drive).is_file()


@of_every_drive
def test_the_binary_was_built_from_these_sources(drive: str) -> None:
    stale = f"fmus/{drive}/{drive}.fmu is stale: run python fmus/build.py {drive}"
    assert described(drive).guid == load_drive(drive).guid, stale
    with zipfile.ZipFile(fmu_path(drive)) as archive:
        assert archive.read("modelDescription.xml") == model_description(load_drive(drive)), stale
        for source in load_drive(drive).sources:
            assert archive.read(f"sources/{source.name}") == source.read_bytes(), stale
        # the GUID compiled into the library is what fmi2Instantiate compares with
        for platform, (suffix, _) in TARGETS.items():
            assert load_drive(drive).guid.encode() in archive.read(f"binaries/{platform}/{drive}.{suffix}")


@of_every_drive
def test_the_documentation_is_the_readme_beside_it(drive: str) -> None:
    with zipfile.ZipFile(fmu_path(drive)) as archive:
        readme = fmu_path(drive).with_name("README.md").read_bytes()
        assert archive.read("documentation/README.md") == readme


@of_every_drive
def test_the_description_is_valid(drive: str) -> None:
    assert validate_fmu(str(fmu_path(drive))) == []


@of_every_drive
def test_outputs_declare_no_direct_feed_through(drive: str) -> None:
    description = described(drive)
    outputs = {unknown.variable.name: unknown.dependencies for unknown in description.outputs}
    assert outputs == {v.name: [] for v in description.modelVariables if v.causality == "output"}


@of_every_drive
def test_every_variable_has_a_defined_unit_and_a_description(drive: str) -> None:
    defined = {unit.name for unit in described(drive).unitDefinitions}
    for variable in described(drive).modelVariables:
        assert variable.unit in defined
        assert variable.description


def test_droop_has_the_unit_of_speed_per_torque() -> None:
    units = {unit.name: unit.baseUnit for unit in described("velocity_servo").unitDefinitions}
    droop, speed, torque = units["rad/(s.N.m)"], units["rad/s"], units["N.m"]
    for base in ("kg", "m", "s", "A", "rad"):
        quotient = int(getattr(speed, base) or 0) - int(getattr(torque, base) or 0)
        assert int(getattr(droop, base) or 0) == quotient


@of_every_drive
@pytest.mark.parametrize("platform", TARGETS)
def test_every_platform_has_a_library_of_its_format(drive: str, platform: str) -> None:
    with zipfile.ZipFile(fmu_path(drive)) as archive:
        library = archive.read(f"binaries/{platform}/{drive}.{TARGETS[platform][0]}")
    assert library.startswith(MAGIC[platform])


@of_every_drive
def test_no_file_tells_where_it_was_built(drive: str) -> None:
    checkout = str(fmu_path(drive).parents[2]).encode()
    with zipfile.ZipFile(fmu_path(drive)) as archive:
        for name in archive.namelist():
            assert checkout not in archive.read(name), name
        assert f"@rpath/{drive}.dylib".encode() in archive.read(f"binaries/darwin64/{drive}.dylib")


def test_a_universal_binary_points_at_its_aligned_slices() -> None:
    slices = {"x86_64": b"intel" * 1000, "aarch64": b"arm"}
    binary = universal_binary(slices)
    for row, content in enumerate(slices.values()):
        fields = [int.from_bytes(binary[8 + 20 * row + at :][:4]) for at in (0, 4, 8, 12, 16)]
        _, _, offset, size, alignment = fields
        assert binary[offset : offset + size] == content
        assert offset % (1 << alignment) == 0


@pytest.mark.skipif(find_spec("ziglang") is None, reason="no compiler: pip install .[fmus]")
def test_rebuilding_gives_the_same_bytes(tmp_path: Path) -> None:
    drive = load_drive("velocity_servo")
    for name in ("one", "two"):
        write_fmu(drive, ["linux64"], tmp_path / name, tmp_path / f"{name}.fmu")
    assert (tmp_path / "one.fmu").read_bytes() == (tmp_path / "two.fmu").read_bytes()
    with zipfile.ZipFile(fmu_path(drive.name)) as tracked, zipfile.ZipFile(tmp_path / "one.fmu") as rebuilt:
        library = f"binaries/linux64/{drive.name}.so"
        assert tracked.read(library) == rebuilt.read(library)


@pytest.mark.skipif(find_spec("ziglang") is None, reason="no compiler: pip install .[fmus]")
def test_a_program_that_does_not_compile_is_reported(tmp_path: Path) -> None:
    drive = load_drive("ideal_velocity")
    with pytest.raises(subprocess.CalledProcessError):
        broken = type(drive)(drive.name, drive.description, drive.variables[:2], drive.sources, drive.guid)
        write_fmu(broken, ["linux64"], tmp_path, tmp_path / "broken.fmu")
