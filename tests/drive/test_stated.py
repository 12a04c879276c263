from pathlib import Path

import pytest

from tests.drive.archives import altered, redescribed
from twin.errors import InputRefused
from twin.studies.survey.stated import stated


def test_version_kind_and_platforms_are_told_of_any_fmu(root: Path, tmp_path: Path):
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    found = stated(good)
    assert (found.model, found.tool, found.fmi, found.kinds) == ("velocity_servo", "", "2.0", ("co-simulation",))
    assert found.platforms == ("darwin64", "linux64", "win64")
    exchange = stated(redescribed(good, tmp_path / "me.fmu", "<CoSimulation", "<ModelExchange"))
    assert exchange.kinds == ("model exchange",)
    old = stated(redescribed(good, tmp_path / "old.fmu", 'fmiVersion="2.0"', 'fmiVersion="1.0" generationTool="T 1"'))
    assert (old.fmi, old.tool, old.kinds) == ("1.0", "T 1", ("model exchange",))


def test_what_has_no_description_is_no_fmu(root: Path, tmp_path: Path):
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    bad = altered(good, tmp_path / "bad.fmu", lambda n, c: None if n == "modelDescription.xml" else (n, c))
    with pytest.raises(InputRefused, match="not an FMU"):
        stated(bad)
