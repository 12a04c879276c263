"""Reference FMUs are held to their own results, at each of their times."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.systems.linear import Linear
from validation.yardstick import NotHere
from validation.yardsticks import reference_fmus
from validation.yardsticks.reference_fmus import FOLDER, MODELS, YARDSTICKS


@pytest.fixture
def folder(tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A drive at rest that stands for a model."""
    (tmp_path / "2.0").mkdir()
    shutil.copy(root / "fmus" / "ideal_velocity" / "ideal_velocity.fmu", tmp_path / "2.0" / f"{MODELS[0]}.fmu")
    monkeypatch.setenv(FOLDER, str(tmp_path))
    return tmp_path


def results(folder: Path, *rows: str) -> None:
    text = "\n".join(["time,theta_m", *rows, ""])
    (folder / "2.0" / f"{MODELS[0]}_ref.csv").write_text(text)


def test_without_a_folder_nothing_is_run(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv(FOLDER, raising=False)
    for one in YARDSTICKS:
        with pytest.raises(NotHere, match=f"{FOLDER}=a_folder"):
            one.differences()


def test_a_model_that_the_folder_lacks_is_not_run(folder: Path):
    with pytest.raises(NotHere, match=f"has no {MODELS[1]}.fmu"):
        YARDSTICKS[1].differences()


def test_the_same_numbers_hold_and_a_last_digit_does_not(folder: Path):
    step = stepped(folder)
    results(folder, "0,0", f"{5 * step!r},0", f"{10 * step!r},0")
    # the drive carries results of its own
    assert max(YARDSTICKS[0].differences().values()) <= YARDSTICKS[0].bound
    results(folder, "0,0", f"{5 * step!r},1e-11", f"{10 * step!r},0")
    assert max(YARDSTICKS[0].differences().values()) > YARDSTICKS[0].bound


def test_an_fmu_for_model_exchange_is_held_to_its_results_and_to_the_solution_of_its_equations(folder: Path):
    Linear(a=[[-1.0]], c=[[1.0]], x0=[1.0]).fmu(folder / "2.0" / "Dahlquist.fmu")
    t = np.linspace(0.0, 1.0, 101)
    for wrong, bound in ((0.0, 2e-6), (0.1, 0.2)):
        rows = (f"{a!r},{b!r}" for a, b in zip(t.tolist(), (np.exp(-t) + wrong * t).tolist(), strict=True))
        (folder / "2.0" / "Dahlquist_ref.csv").write_text("\n".join(["time,y", *rows, ""]))
        (off,) = reference_fmus.exchanged_beside_results("Dahlquist").values()
        assert 0.4 * wrong < off < bound
    (own,) = reference_fmus.exchanged(folder / "2.0" / "Dahlquist.fmu", t, ["x0"]).values()
    np.testing.assert_allclose(own, reference_fmus._exact("Dahlquist", t)["x"], atol=2e-6)


def test_a_ball_that_bounces_loses_three_tenths_of_its_speed_each_time():
    t = np.linspace(0.0, 3.0, 30_001)
    exact = reference_fmus._exact("BouncingBall", t)
    bounces = np.flatnonzero(np.diff(exact["v"]) > 0.05)
    first = np.sqrt(2.0 / 9.81)
    np.testing.assert_allclose(t[bounces[:2]], [first, 2.4 * first], atol=1e-4)
    np.testing.assert_allclose(exact["v"][bounces[:6] + 1] / exact["v"][bounces[:6]], -0.7, atol=5e-3)
    assert exact["h"].min() >= 0.0 and exact["h"][-1] == 0.0


def test_results_at_other_times_fail(folder: Path):
    step = stepped(folder)
    results(folder, "0,0", f"{5.3 * step!r},0")
    with pytest.raises(RuntimeError, match="other times"):
        reference_fmus.beside_its_results(MODELS[0])


def stepped(folder: Path) -> float:
    """The step of the default experiment (s)."""
    from twin.kernel.fmi.description import described
    from twin.studies.reference.outcome import BareRun, Trial, TrialFiles, bare_run

    runs: list[BareRun] = []
    description = described(folder / "2.0" / f"{MODELS[0]}.fmu")
    bare_run(description, Trial("default experiment"), TrialFiles({}, None, None), runs.append)
    return runs[0].step
