"""What an FMU says of itself, and what is refused before its binary is touched, or when it is."""

import dataclasses
import hashlib
import os
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.archives import DESCRIPTION, altered, redescribed
from tests.kernel.fmi.compiled import compiled_drive
from tests.kernel.fmi.test_component import made, run
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi import description
from twin.kernel.fmi.description import described
from twin.kernel.fmi.variable import NUMERIC_TYPES

DRIVES = ("ideal_velocity", "velocity_servo", "pmsm_foc")


@pytest.fixture
def servo(root: Path) -> Path:
    return root / "fmus" / "velocity_servo" / "velocity_servo.fmu"


def refusal(path: Path) -> str:
    with pytest.raises(InputRefused) as refused:
        described(path)
    assert refused.value.exit_code == 2
    return str(refused.value)


@pytest.mark.parametrize("name", DRIVES)
def test_every_shipped_drive_fits_the_contract(root: Path, name: str):
    drive = described(root / "fmus" / name / f"{name}.fmu")
    assert [v.name for v in drive.variables_of("input")] == ["omega_ref", "tau_load"]
    assert [v.name for v in drive.variables_of("output")][:2] == ["theta_m", "omega_m"]
    assert drive.warnings() == []
    assert {"linux64", "win64", "darwin64"} <= set(drive.platforms)


def test_the_hash_is_that_of_the_file(servo: Path):
    assert described(servo).sha256 == hashlib.sha256(servo.read_bytes()).hexdigest()


def test_what_is_not_there_is_refused(tmp_path: Path):
    assert "no such FMU" in refusal(tmp_path / "none.fmu")


def test_a_zip_without_description_is_refused(tmp_path: Path, servo: Path):
    bad = altered(servo, tmp_path / "bad.fmu", lambda n, c: None if n == DESCRIPTION else (n, c))
    assert "no modelDescription.xml" in refusal(bad)


def test_a_description_that_is_packed_elsewhere_is_refused_with_its_place(tmp_path: Path, servo: Path):
    for place in (f"./{DESCRIPTION}", f"servo/{DESCRIPTION}"):

        def moved(name: str, content: bytes, to: str = place) -> tuple[str, bytes]:
            return (to if name == DESCRIPTION else name), content

        bad = altered(servo, tmp_path / "bad.fmu", moved)
        with pytest.raises(InputRefused) as refusal:
            described(bad)
        told = f"{bad}: its {DESCRIPTION} is packed as '{place}'; pack it again without that folder"
        assert str(refusal.value) == told


def test_two_variables_of_one_name_are_refused_with_both_references(tmp_path: Path, servo: Path):
    bad = redescribed(servo, tmp_path / "bad.fmu", 'name="omega_m"', 'name="theta_m"')
    first, second = (described(servo).variables[name].reference for name in ("theta_m", "omega_m"))
    references = rf"\(value references {min(first, second)} and {max(first, second)}\)"
    with pytest.raises(InputRefused, match=rf"two variables are named 'theta_m' {references}"):
        described(bad)


def test_an_unreadable_description_is_refused(tmp_path: Path, servo: Path):
    bad = altered(servo, tmp_path / "bad.fmu", lambda n, c: (n, c[:100] if n == DESCRIPTION else c))
    assert "cannot be read" in refusal(bad)


@pytest.mark.parametrize("drive", ["velocity_servo", "torque_motor_fmi3"])
def test_a_description_without_any_one_attribute_or_element_is_read_or_refused_in_our_own_words(
    root: Path, tmp_path: Path, drive: str
):
    good = root / "fmus" / drive / f"{drive}.fmu"
    with zipfile.ZipFile(good) as archive:
        text = archive.read(DESCRIPTION).decode()
    parts = sorted({found[0] for found in re.finditer(r'(?<=[^?]) [\w:]+="[^"]*"|<(Real|Float64)[^<>]*/>', text)})
    refused = 0
    for number, part in enumerate(parts):
        shorter = {DESCRIPTION: text.replace(part, "", 1).encode()}

        def change(name: str, content: bytes, new: dict[str, bytes] = shorter) -> tuple[str, bytes]:
            return name, new.get(name, content)

        # FMPy keeps what it has read of a file
        bad = altered(good, tmp_path / f"{number}.fmu", change)
        try:
            described(bad)
        except InputRefused as refusal:
            refused += 1
            assert "FMPy" not in str(refusal) and "None" not in str(refusal), (part, str(refusal))
    assert refused >= 4, refused


def test_a_drive_without_this_platforms_binary_is_refused_with_what_it_has(tmp_path: Path, servo: Path):
    # folders elsewhere in the archive are no platforms, nor is an empty one
    bad = altered(servo, tmp_path / "bad.fmu", lambda n, c: ("resources/plan9/x/y.so" if "linux64" in n else n, c))
    with zipfile.ZipFile(bad, "a") as archive:
        archive.writestr("binaries/linux64/", b"")
    assert "no binary for this platform" in refusal(bad)
    assert "it has darwin64, win64" in refusal(bad)


def test_a_binary_of_another_name_than_the_description_says_is_told_of(tmp_path: Path, servo: Path):
    def renamed(name: str, content: bytes) -> tuple[str, bytes]:
        return name.replace("linux64/velocity_servo", "linux64/servo"), content

    said = refusal(altered(servo, tmp_path / "bad.fmu", renamed))
    assert (
        "its binary for this platform is servo.so; by its modelIdentifier it has to be called velocity_servo.so" in said
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('canGetAndSetFMUstate="true"', 'needsExecutionTool="true"', "needs its authoring tool"),
        ("<CoSimulation", "<ScheduledExecution", "without co-simulation and model exchange"),
    ],
)
def test_what_is_no_co_simulation_of_its_own_is_refused(tmp_path: Path, servo: Path, old: str, new: str, said: str):
    assert said in refusal(redescribed(servo, tmp_path / "bad.fmu", old, new))


FMI_1 = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="1.0" modelName="old" modelIdentifier="old" guid="{1}" numberOfContinuousStates="0"
  numberOfEventIndicators="0"><ModelVariables/></fmiModelDescription>"""


def test_model_exchange_of_fmi_1_is_refused_with_what_to_export_instead(tmp_path: Path, servo: Path):
    bad = altered(servo, tmp_path / "bad.fmu", lambda n, c: (n, FMI_1 if n == DESCRIPTION else c))
    assert "FMI 1.0 without co-simulation; export it for co-simulation" in refusal(bad)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"drop": 0.5}, "no parameter 'drop'; did you mean 'droop'?"),
        ({"T_m": -1.0}, "parameter T_m = -1: expected"),
        ({"droop": float("nan")}, "parameter droop = nan"),
    ],
)
def test_a_wrong_parameter_is_refused(servo: Path, values: dict[str, float], said: str):
    with pytest.raises(InputRefused, match="parameter") as refused:
        described(servo).settings(values)
    assert said in str(refused.value)


def test_a_file_is_read_again_when_it_has_changed_and_only_then(
    tmp_path: Path, servo: Path, monkeypatch: pytest.MonkeyPatch
):
    # else all that a test writes is too young to be remembered
    monkeypatch.setattr(description, "MIN_FILE_AGE", -1)
    copy = tmp_path / "copy.fmu"
    copy.write_bytes(servo.read_bytes())
    first = described(copy)
    assert described(copy) is first
    times = copy.stat().st_atime_ns, copy.stat().st_mtime_ns
    altered(servo, tmp_path / "other.fmu", lambda n, c: (n, c + b" " if n == DESCRIPTION else c)).replace(copy)
    # even one that pretends to be as old as the one before
    os.utime(copy, ns=times)
    assert described(copy).sha256 == hashlib.sha256(copy.read_bytes()).hexdigest() != first.sha256
    copy.write_bytes(b"no FMU any more")
    assert "not a complete FMU" in refusal(copy)


def test_a_file_that_has_just_been_written_is_read_each_time(tmp_path: Path, servo: Path):
    copy = tmp_path / "copy.fmu"
    copy.write_bytes(servo.read_bytes())
    assert described(copy) is not described(copy)


def test_a_description_of_64_MiB_is_read_and_one_of_a_byte_more_is_not(
    tmp_path: Path, servo: Path, monkeypatch: pytest.MonkeyPatch
):
    copy = altered(servo, tmp_path / "copy.fmu", lambda n, c: (n, c))
    monkeypatch.setattr(description, "entries", lambda file: {DESCRIPTION: 67_108_864})
    assert "no binary for this platform" in refusal(copy)
    monkeypatch.setattr(description, "entries", lambda file: {DESCRIPTION: 67_108_865})
    assert "do not trust this file" in refusal(copy)


def test_every_variable_that_is_a_number_is_offered_and_no_other(root: Path):
    drive = described(root / "fmus" / "torque_motor_fmi3" / "torque_motor_fmi3.fmu")
    speed = drive.variables["omega_m"]
    kinds = {"real": 0, "whole": NUMERIC_TYPES.index("Int32"), "flag": NUMERIC_TYPES.index("Boolean"), "text": -1}
    variables = {name: dataclasses.replace(speed, name=name, kind=kind) for name, kind in kinds.items()}
    offered = dataclasses.replace(drive, variables=variables).variables_of("output")
    assert [v.name for v in offered] == ["real", "whole", "flag"]


STEP = "fmi2Status fmi2DoStep("


def returning(status: str, condition: str) -> Any:
    """An edit of lifecycle.c: fmi2DoStep returns `status` while `condition` holds."""

    def edit(text: str) -> str:
        assert STEP in text
        shim = (
            f"\n{STEP}fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b)\n"
            f"{{\n    return {condition} ? {status} : honest_step(c, t, h, b);\n}}\n"
        )
        return text.replace(STEP, "static fmi2Status honest_step(") + shim

    return edit


@pytest.mark.parametrize("status", ["fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending"])
@pytest.mark.parametrize("condition", ["t > 0.0995", "(t > 0.0995 && t < 0.1005)"])
def test_a_bad_status_once_or_for_ever_stops_the_run_at_that_step(
    root: Path, tmp_path: Path, status: str, condition: str
):
    bad = compiled_drive(root, tmp_path, "bad", {"lifecycle.c": returning(status, condition)})
    with pytest.raises(ComponentFailed) as failure:
        run(made(bad), 1.0, 0.0)
    assert str(failure.value).startswith(f"bad.fmu (drive_1) fmi2DoStep returned {status}")
    assert "in the step from t = 0.1 s, tick 100. Last inputs: omega_ref = 1 rad/s, tau_load = 0 N m." in str(
        failure.value
    )


def test_a_warning_does_not_stop_the_run(root: Path, tmp_path: Path):
    bad = compiled_drive(root, tmp_path, "bad", {"lifecycle.c": returning("fmi2Warning", "0")})
    assert np.isfinite(run(made(bad), 1.0, 0.0)["theta_m"]).all()


def test_an_fmu_that_gives_no_instance_is_refused(root: Path, tmp_path: Path):
    def edit(text: str) -> str:
        return text.replace("    Slave *slave = malloc(sizeof *slave);", "    Slave *slave = NULL;")

    bad = compiled_drive(root, tmp_path, "bad", {"lifecycle.c": edit})
    with pytest.raises(InputRefused, match="fmi2Instantiate refused") as refused:
        made(bad)
    assert "out of memory" in str(refused.value)


def test_a_missing_function_is_refused_by_name(root: Path, tmp_path: Path):
    def edit(text: str) -> str:
        return text.replace(STEP, "static fmi2Status unused(")

    bad = compiled_drive(root, tmp_path, "bad", {"lifecycle.c": edit})
    with pytest.raises(InputRefused, match="does not load") as refused:
        made(bad)
    assert "fmi2DoStep" in str(refused.value)


def test_an_initialisation_that_fails_is_refused_with_what_the_fmu_said(root: Path, tmp_path: Path):
    def edit(text: str) -> str:
        entry = "fmi2Status fmi2EnterInitializationMode(fmi2Component c)\n{\n"
        assert entry in text
        return text.replace(entry, entry + '    return refuse(c, "licence not found");\n')

    bad = compiled_drive(root, tmp_path, "bad", {"lifecycle.c": edit})
    with pytest.raises(InputRefused, match="cannot be initialised") as refused:
        made(bad)
    assert "licence not found" in str(refused.value)


def test_a_description_that_is_too_large_is_refused_unread(
    tmp_path: Path, servo: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(description, "MAX_DESCRIPTION_SIZE", 1000)
    # the servo itself may have been read before
    large = altered(servo, tmp_path / "large.fmu", lambda n, c: (n, c))
    with pytest.raises(InputRefused, match=r"modelDescription\.xml has"):
        description.described(large)


def test_entities_that_multiply_are_not_expanded(tmp_path: Path, servo: Path):
    bomb = (
        b"""<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">%s]><fmiModelDescription fmiVersion="&i;"/>"""
        % (b"".join(b'<!ENTITY %c "%s">' % (98 + i, b"&%c;" % (97 + i) * 10) for i in range(8)))
    )
    bad = altered(servo, tmp_path / "bad.fmu", lambda n, c: (n, bomb if n == DESCRIPTION else c))
    with pytest.raises(InputRefused, match=r"modelDescription\.xml"):
        description.described(bad)


def test_a_drive_for_another_platform_only_is_refused_with_what_to_do(tmp_path: Path, servo: Path):
    bad = altered(servo, tmp_path / "bad.fmu", lambda n, c: None if "linux64" in n else (n, c))
    with pytest.raises(InputRefused, match=r"it has darwin64, win64\. Export it for"):
        description.described(bad)


def test_a_drive_that_needs_its_tool_is_refused(tmp_path: Path, servo: Path):
    bad = redescribed(servo, tmp_path / "bad.fmu", 'canGetAndSetFMUstate="true"', 'needsExecutionTool="true"')
    with pytest.raises(InputRefused, match="needs its authoring tool"):
        description.described(bad)


def test_of_the_standard_only_the_unusual_kind_is_named(root: Path):
    both = described(root / "fmus" / "modelica_dc" / "modelica_dc.fmu")
    assert both.standard == "FMI 2.0"
    assert dataclasses.replace(both, kind="model_exchange").standard.startswith("FMI 2.0 ")
