"""What a body gets never exceeds the tank: without faults, and with those of commands, messages and gains."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.laws.runs import EXPERIMENTS
from twin.errors import InputRefused
from twin.experiment.fault_catalogue import CATALOGUE
from twin.runs.assembly.assemble import assemble
from twin.runs.assembly.load import load_experiment
from twin.runs.loop import simulate
from twin.runs.trace import Trace

SIZE = 0.06
TANK = f"controller.energy_tank.size_J={SIZE}"
ALONE = "monitor.enabled=false"
"""Nobody else helps."""
BODIES = sorted(path.stem for path in (EXPERIMENTS / "bodies").glob("*.toml"))
COMMANDS_AND_MESSAGES = [kind for kind, known in CATALOGUE.items() if known.mechanism in ("command", "message")]
GAINS = {
    "controller.position.kp_per_s": (1.0, 60.0, 200.0),
    "controller.force.kp_mm_per_N": (5.0, 50.0),
    "controller.force.ki_mm_per_N_s": (40.0, 400.0),
}
ONSETS = (0.5, 2.0, 4.0, 5.53)


def pressed(*settings: str, body: str | None = None, name: str = "pressing") -> Trace:
    """A run; one that a component ends until then."""
    experiment, run = load_experiment(EXPERIMENTS / f"{name}.toml", settings, None, body), Trace()
    with assemble(experiment) as assembly:
        simulate(assembly, experiment.duration_ticks, [run])
    return run


def energy(run: Trace) -> NDArray[np.float64]:
    """What has truly gone through the head into the body since the start (J), at every tick."""
    F, p = run.held("plant.F_ee_B"), run.held("plant.p_B")
    return np.concatenate([[0.0], np.cumsum(np.sum(0.5 * (F[1:] + F[:-1]) * np.diff(p, axis=0), axis=1))])


def most_given(run: Trace) -> float:
    """The most that went in since any time (J)."""
    gone = energy(run)
    return float(np.max(gone - np.minimum.accumulate(gone)))


def faults() -> list[str]:
    found = []
    for kind in COMMANDS_AND_MESSAGES:
        key, magnitudes = CATALOGUE[kind].magnitude_key, CATALOGUE[kind].magnitudes or ()
        found += [f'fault=[{{kind="{kind}", onset_s={t}, {key}={m}}}]' for m in magnitudes for t in ONSETS]
    for key, values in GAINS.items():
        found += [f'change=[{{t_s={t}, key="{key}", value={value}}}]' for value in values for t in ONSETS]
    return found


SHORT = [
    'fault=[{kind="sample_delay", onset_s=2.0, magnitude_ms=50}]',
    'fault=[{kind="sample_loss", onset_s=4.0, magnitude_share=1.0}]',
    'fault=[{kind="controller_overrun", onset_s=0.5, magnitude_ms=50}]',
    'fault=[{kind="brown_out", onset_s=0.5, magnitude_share=0.01}]',
    'change=[{t_s=4.0, key="controller.force.ki_mm_per_N_s", value=400.0}]',
    'change=[{t_s=0.5, key="controller.position.kp_per_s", value=200.0}]',
]


@pytest.mark.parametrize("fault", ["fault=[]", *SHORT])
@pytest.mark.parametrize("body", ["belly", "back"])
def test_no_body_gets_more_than_the_tank_holds(body: str, fault: str):
    assert most_given(pressed(TANK, ALONE, fault, body=body)) <= SIZE


@pytest.mark.endurance
@pytest.mark.parametrize("body", BODIES)
def test_no_body_gets_more_than_the_tank_holds_with_any_fault_of_commands_messages_and_gains(body: str):
    too_much = {
        fault: given for fault in faults() if (given := most_given(pressed(TANK, ALONE, fault, body=body))) > SIZE
    }
    assert too_much == {}


def past_it(root: Path) -> list[list[str]]:
    """The cells of the table of docs/passivity.md."""
    behind = (root / "docs" / "passivity.md").read_text().partition("tests/laws/test_energy_tank.py -->\n")[2]
    lines = behind.strip().partition("\n\n")[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


@pytest.mark.endurance
def test_what_gets_past_it_is_what_the_page_says(root: Path):
    rows = past_it(root)
    assert len(rows) == 8
    for kind, magnitude, onset, body, *stated in rows:
        name = kind.strip("`")
        fault = f'fault=[{{kind="{name}", onset_s={onset}, {CATALOGUE[name].magnitude_key}={magnitude}}}]'
        press = {"scale": None}.get(body, body)
        ways: tuple[list[str], ...] = ([TANK, ALONE], [ALONE], [TANK], [])
        found = [most_given(pressed(*own, fault, body=press)) for own in ways]
        # three decimals, and what another processor rounds
        np.testing.assert_allclose(
            found, [float(cell) for cell in stated], rtol=0.02, atol=0.001, err_msg=f"{name}, {body}"
        )


def test_without_a_tank_some_of_them_give_a_body_far_more():
    assert most_given(pressed(ALONE, SHORT[0], body="back")) > 4.0 * SIZE
    assert most_given(pressed(ALONE, SHORT[4], body="back")) > 4.0 * SIZE


DRIVES = [kind for kind, known in CATALOGUE.items() if known.mechanism == "drive"]


@pytest.mark.parametrize("body", [None, "belly", pytest.param("back", marks=pytest.mark.endurance)])
@pytest.mark.parametrize("kind", ["drive_runaway", *(
    pytest.param(kind, marks=pytest.mark.endurance) for kind in DRIVES if kind != "drive_runaway"
)])  # fmt: skip
def test_a_drive_that_fails_gives_no_more_because_of_the_tank(kind: str, body: str | None):
    # those that still obey pull away, whatever the tank has kept back before, and whatever the third is told
    known = CATALOGUE[kind]
    largest = f", {known.magnitude_key}={known.magnitudes[-1]}" if known.magnitudes else ""
    for onset in (2.0, 5.53):
        fault = f'fault=[{{kind="{kind}", onset_s={onset}{largest}}}]'
        tank, none = (most_given(pressed(*own, ALONE, fault, body=body)) for own in ([TANK], []))
        # the two presses differ before the drive fails
        assert tank <= 1.01 * none, f"{kind} at {onset} s"


@pytest.mark.parametrize("name", ["pushing", "rolling"])
def test_friction_empties_it_and_then_the_robot_stops(name: str):
    run = pressed(TANK, ALONE, name=name)
    assert 0.8 * SIZE < most_given(run) <= SIZE
    # as it believes itself; where a head that has lagged behind lifts off, the platform's inertia counts as force
    assert most_given(run) - 0.003 < run["tank.given"].max() < most_given(run) + 0.006
    assert run["tank.share"].min() < 0.02


def test_a_tank_that_is_large_enough_costs_nothing():
    with_tank, without = (pressed(*tank) for tank in (["controller.energy_tank.size_J=0.15"], []))
    assert with_tank["tank.share"].min() == 1.0
    assert np.array_equal(with_tank["plant.F_ee_B"], without["plant.F_ee_B"])


def test_without_the_table_nothing_of_it_is_there():
    assert [name for name in pressed(name="step_z_air").fields() if name.startswith("tank.")] == []


@pytest.mark.parametrize("onset", [4.0, 5.53])
def test_a_surface_that_drops_away_is_followed_at_a_bounded_speed(onset: float):
    lost = f'fault=[{{kind="contact_loss", onset_s={onset}, magnitude_mm=40}}]'
    # a task would notice and give up
    patient = "controller.touch.patience_ms=100000"
    tank, bare = (pressed(*own, ALONE, lost, patient) for own in ([TANK], []))

    def fastest(run: Trace, after: float) -> float:
        return float(-run.held("plant.v_B")[round((onset + after) / 1e-3) :, 2].min())

    # the springs throw the platform after it whoever controls; what follows is the controller's
    assert fastest(tank, 0.05) < 0.85 * fastest(bare, 0.05)
    # 1/2 K (v T)^2 <= size: 75 mm/s with 2137 N/m, as at home; lower down the springs are softer
    assert fastest(tank, 0.3) < 0.09
    assert most_given(tank) <= SIZE


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("size_J=0", "size_J = 0.*expected a number > 0"),
        ("size_J=-1", "expected a number > 0"),
        ("size=0.1", "unknown key 'size'; did you mean 'size_J'"),
        ("horizon_ms=0", "expected a number > 0"),
    ],
)
def test_a_tank_that_is_none_is_refused(setting: str, told: str):
    with pytest.raises(InputRefused, match=told):
        pressed(*([] if "size" in setting else [TANK]), f"controller.energy_tank.{setting}")
