"""Real bad FMUs: what they return, lack or declare ends in one sentence and the right exit code."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.drive.archives import DESCRIPTION, altered, redescribed
from tests.drive.compiled import compiled_drive
from tests.drive.test_component import made, run
from twin.drive import description
from twin.errors import ComponentFailed, InputRefused

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


@pytest.fixture
def servo(root: Path) -> Path:
    return root / "fmus" / "velocity_servo" / "velocity_servo.fmu"


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
    monkeypatch.setattr(description, "MOST_DESCRIPTION", 1000)
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
