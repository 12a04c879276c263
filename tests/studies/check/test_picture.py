"""Pictures of curves outside their tubes."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from twin.kernel.errors import InputRefused
from twin.studies.check.text import MAX_SHOWN, check_pictures
from twin.studies.check.verdict import CheckVerdict, TubeDeparture

t = np.linspace(0.5, 4.0, 40)
NOW = np.where(t > 3.0, np.nan, -1.05 * t)
CURVE = TubeDeparture("z.tube", "plant.p_B[2]", "m", *(line.tolist() for line in (t, -t, -t - 0.1, -t + 0.1, NOW)))


def outside(drive: str, *curves: TubeDeparture) -> CheckVerdict:
    return CheckVerdict("step_z_air", drive, (), (), curves)


def test_each_check_has_a_picture_with_a_panel_per_curve_and_it_is_the_same_every_time(tmp_path: Path):
    verdicts = [outside("a", CURVE), outside("vendor/b.fmu", CURVE, CURVE), outside("c")]
    first, second = check_pictures(verdicts, tmp_path / "x"), check_pictures(verdicts, tmp_path / "y")
    assert [path.name for path in first] == ["step_z_air_a.png", "step_z_air_b.png"]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    with Image.open(first[0]) as one, Image.open(first[1]) as two:
        assert two.height > 1.5 * one.height


def test_of_many_checks_only_some_have_pictures(tmp_path: Path):
    assert len(check_pictures([outside(f"d{k}", CURVE) for k in range(MAX_SHOWN + 1)], tmp_path)) == MAX_SHOWN


def test_a_disk_that_refuses_is_told(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputRefused, match="cannot be created"):
        check_pictures([outside("a", CURVE)], tmp_path / "file")
