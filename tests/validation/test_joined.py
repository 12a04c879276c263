"""FMUs of others are joined as they are asked to be, and what they are measured against is right."""

from pathlib import Path

import numpy as np
import pytest

from tests.kernel.systems.linear import Linear
from twin.kernel.systems.choice import MasterChoice
from validation.joined import joined
from validation.pinned import PinnedFiles
from validation.yardsticks.siso_parts import exact


def test_components_have_the_signals_of_what_feeds_them(root: Path):
    ideal = root / "fmus" / "ideal_velocity" / "ideal_velocity.fmu"
    seen, wires = ["b.omega_m", "a.theta_m"], [("a.omega_m", "b.omega_ref")]
    run = joined(dict.fromkeys("ab", ideal), MasterChoice(tick=1e-3), 0.004, seen, wires, ["a.omega_ref=2"], every=2)
    np.testing.assert_allclose(run["a.theta_m"], [0.0, 0.004, 0.008], atol=1e-12)
    np.testing.assert_array_equal(run["b.omega_m"][1:], [2.0, 2.0])


def test_what_ends_a_run_ends_its_signals(tmp_path: Path):
    fmu = Linear(c=[[1.0]], x0=[1.0], ends_at=0.05).fmu(tmp_path / "a.fmu")
    assert len(joined({"a": fmu}, MasterChoice(tick=0.01), 0.2, ["a.y"])["a.y"]) == 6


def test_a_pi_whose_error_stays_grows_as_a_line(monkeypatch: pytest.MonkeyPatch):
    tables = {"setpoint": b"time,speed\n0,0.001\n4,0.001\n", "drivetrain": b"time,w\n0,0\n4,0\n"}
    monkeypatch.setattr(PinnedFiles, "content", lambda self, path: tables[Path(path).stem])
    # v = 100 (e + 10 e t) below the limit of 12
    assert exact() == pytest.approx(100.0 * (0.001 + 10.0 * 0.001 * 4.0), rel=1e-9)
