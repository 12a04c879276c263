"""A third-party part on the bench: what it is called with, and what is said of it."""

from pathlib import Path
from typing import Any

import pytest

from tests.kernel.fmi.archives import altered
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.studies.qualify.part_check import contracts, part_check
from twin.studies.result import Result

LAW = "fmus/parts/paper_law"
BRIEF = "duration_s=0.5"
CLASSES = """
import itertools

count = itertools.count()


class Good:
    inputs = ("p_B",)
    outputs = ("omega_ref",)

    def step(self, t, inputs):
        return {"omega_ref": inputs["p_B"]}


class Late(Good):
    def __init__(self):
        self.before = [0.0] * 3

    def step(self, t, inputs):
        answer, self.before = self.before, inputs["p_B"]
        return {"omega_ref": answer}


class Deaf(Good):
    def step(self, t, inputs):
        return {"omega_ref": [t] * 3}


class Restless(Good):
    def step(self, t, inputs):
        return {"omega_ref": [float(next(count))] * 3}


class Unfinished(Good):
    def step(self, t, inputs):
        return {"omega_ref": [float("nan") if t > 0.1 else 0.0] * 3}


class Breaks(Good):
    def step(self, t, inputs):
        return {"omega_ref": [1 / (t < 0.1)] * 3}


class Slow(Good):
    def step(self, t, inputs):
        import time
        time.sleep(0.002)
        return {"omega_ref": [0.0] * 3}


class Scale:
    inputs = ("F_ee_B",)
    outputs = ("F_z",)

    def step(self, t, inputs):
        return {"F_z": round(-inputs["F_ee_B"][2] / 0.04905) * 0.04905}


class Monitor:
    inputs = ("omega_ref", "sample")
    outputs = ("omega_ref", "tripped", "power")

    def step(self, t, inputs):
        return {"omega_ref": inputs["omega_ref"], "tripped": False, "power": 1}
"""


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(CLASSES)
    return file


def checked(role: str, part: str | None, *settings: str, experiment: str = "fig4_force_position") -> Result:
    return part_check(role, part, Path(experiment), [BRIEF, *settings], say=lambda what: None)


def verdicts(answer: Result) -> dict[str, str]:
    return {one["name"]: one["verdict"] for one in answer.facts["checks"]}


def detail(answer: Result, name: str) -> str:
    return next(one["detail"] for one in answer.facts["checks"] if one["name"] == name)


def test_the_papers_law_as_an_fmu_passes_and_does_what_twins_own_does():
    answer = checked("controller", LAW)
    assert answer.exit_code == 0
    assert set(verdicts(answer).values()) == {"ok"}
    assert verdicts(answer).keys() == {"calls", "repeatable", "reset", "state", "instant"}
    # other systems' exp may differ in the last bit
    assert max(answer.facts["largest_difference_to_own"].values()) <= 1e-12
    assert answer.text.splitlines()[0].startswith("controller: paper_law.fmu, every 2 ms, sha256 ")
    assert max(map(len, answer.text.splitlines())) <= 80


def test_another_gain_is_told_as_a_difference_and_no_fault():
    answer = checked("controller", LAW, "controller.parameters.position_kp=3")
    assert answer.exit_code == 0
    assert answer.facts["largest_difference_to_own"]["omega_ref"] > 1e-3
    assert answer.facts["part"]["set"] == {"position_kp": 3.0}


@pytest.mark.parametrize(
    ("kind", "name", "verdict", "said"),
    [
        ("Good", "instant", "ok", "outputs of t_k answer the inputs of t_k"),
        ("Late", "instant", "note", "outputs answer inputs 2 ms late: an internal delay"),
        ("Deaf", "instant", "note", "no output answers its inputs within"),
        ("Restless", "repeatable", "fails", "a new one gives other outputs from the same inputs"),
        ("Unfinished", "calls", "fails", "returned NaN or infinity for omega_ref at t = 0.102 s, call 52"),
        ("Breaks", "calls", "fails", r"raised ZeroDivisionError: division by zero (mine.py, line "),
    ],
)
def test_what_a_class_does_is_found(mine: Path, kind: str, name: str, verdict: str, said: str):
    answer = checked("controller", f"{mine}:{kind}")
    assert (verdicts(answer)[name], answer.exit_code) == (verdict, 1 if verdict == "fails" else 0)
    assert said in detail(answer, name)
    assert answer.text.endswith(f"{'cannot' if answer.exit_code else 'can'} take its place as controller")


def test_a_part_that_runs_cannot_be_scored_with_is_warned_of(mine: Path):
    answer = checked("controller", f"{mine}:Good")
    assert (answer.exit_code, verdicts(answer)["scored"]) == (0, "note")
    missing = "no output p_ref_B, p_cmd_B, F_z, F_z_ref, triggered: twin report cannot score the estimated force"
    assert detail(answer, "scored").startswith(missing)
    answer = part_check("controller", f"{mine}:Good", Path("pressing"), [], say=lambda what: None)
    assert "no output task, phase: twin compare --paper fig5" in detail(answer, "scored")


def test_a_slow_part_is_not_waited_for(mine: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("twin.studies.qualify.bench.CALLS_TIME_LIMIT", 0.05)
    monkeypatch.setattr("twin.studies.qualify.bench.CALLS_PER_BLOCK", 5)
    answer = checked("controller", f"{mine}:Slow")
    assert "the rest would take too long" in detail(answer, "calls")
    assert answer.facts["cost_s"] > 0.002


def test_any_part_is_called_with_what_twins_own_gets(mine: Path):
    answer = checked("scale", f"{mine}:Scale", "duration_s=7", "scale.period_ms=10")
    assert answer.facts["period_s"] == pytest.approx(0.01)
    assert answer.facts["largest_difference_to_own"]["F_z"] < 1e-9
    answer = checked("monitor", f"{mine}:Monitor")
    assert verdicts(answer)["calls"] == "ok"


def test_the_part_that_an_experiment_names_is_checked_in_its_own_run(mine: Path, tmp_path: Path):
    file = tmp_path / "mine.toml"
    file.write_text('extends = "fig4_force_position.toml"\n[controller]\npython = "mine.py:Good"\n')
    answer = checked("controller", None, experiment=str(file))
    assert answer.facts["largest_difference_to_own"] is None
    assert answer.exit_code == 0


def test_a_state_that_does_not_come_back_is_a_note(root: Path, tmp_path: Path):
    old, new = b'canGetAndSetFMUstate="true"', b'canGetAndSetFMUstate="false"'
    file = altered(root / LAW / "paper_law.fmu", tmp_path / "law.fmu", lambda n, c: (n, c.replace(old, new)))
    mapping = tmp_path / "mapping.toml"
    mapping.write_text('fmu = "law.fmu"\n[inputs]\np_ref_B = ["way_1", "way_2", "way_3"]\n')
    answer = checked("controller", str(mapping))
    assert (verdicts(answer)["state"], answer.exit_code) == ("note", 0)
    assert file.is_file()


@pytest.mark.parametrize(
    ("role", "part", "said"),
    [
        ("plant", LAW, "plant: not a part that can be third-party; these can: body, estimator"),
        ("controller", None, "its controller is twin's own; name an FMU, or FILE:CLASS"),
        ("controller", "fmus/velocity_servo", "which of its outputs is omega_ref"),
        ("estimator", LAW, "no input 'p_ref_B'; it has count_m, count_l"),
        ("controller", "nowhere.py:Mine", "no file"),
    ],
)
def test_what_cannot_be_checked_is_refused(role: str, part: str | None, said: str):
    with pytest.raises((InputRefused, ComponentFailed), match=said):
        checked(role, part)


def test_the_list_has_every_port_within_80_columns():
    answer = contracts()
    facts: Any = answer.facts
    assert [p["name"] for p in facts["controller"]["outputs"] if p["required"]] == ["omega_ref"]
    assert not any(p["required"] for role in facts.values() for p in role["inputs"])
    assert max(map(len, answer.text.splitlines())) <= 80
