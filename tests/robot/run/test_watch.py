"""What a run tells of itself: each event at its tick, in order of time, in the recording and to the caller."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import twin
from tests.kernel.fmi.warning import warning_drive
from tests.laws.runs import shipped
from twin.kernel.cosim.observers import TickEvent
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording, read
from twin.kernel.recording.recorder import RowStream
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.program import PhaseKind
from twin.robot.run.cost import MAX_DISK_BYTES, estimate, refuse_endless
from twin.robot.run.run import SLICE_TICKS, Run, execute
from twin.robot.run.tuning import Tuning
from twin.robot.scene import Scene

REFERENCE = "controller.force.reference_N"
TOUCHING = ("duration_s=2", "contact.height_mm=-85.5")
"""A scale so high that contact begins soon."""


class Knob:
    """A viewer that does `turn` once: when tick `at` is the next, or before the first if that is 0."""

    def __init__(self, turn: Callable[[Tuning], object], at: int = 0):
        self._turn, self._at = turn, at

    def begin(self, streams: Sequence[RowStream], scene: Scene, tick: float, tuning: Tuning) -> None:
        self.tuning = tuning
        if self._at == 0:
            self._turn(tuning)

    def show(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        if first + len(rows) == self._at:
            self._turn(self.tuning)


def turned(
    folder: Path, knob: Knob, name: str = "fig4_force_position", overrides: Sequence[str] = TOUCHING
) -> tuple[Run, Recording]:
    folder.mkdir()
    run = execute(shipped(name, *overrides), folder, viewer=knob)
    return run, read(run.recording)


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("fig4_force_position", ["force.reference_N", "force.kp_mm_per_N", "force.ki_mm_per_N_s", "position.kp_per_s"]),
        # its force loop never acts
        ("fig4_position", ["position.kp_per_s"]),
        # its tasks bring their own forces
        ("pressing", ["force.kp_mm_per_N", "force.ki_mm_per_N_s", "position.kp_per_s"]),
    ],
)
def test_what_can_be_changed_is_what_acts(tmp_path: Path, name: str, keys: list[str]):
    values: dict[str, float] = {}
    run, _ = turned(tmp_path / "x", Knob(lambda tuning: values.update(tuning.values())), name, ())
    assert list(values) == [f"controller.{key}" for key in keys]
    assert not run.changed


@pytest.mark.parametrize(
    ("key", "number"),
    [
        (REFERENCE, 6.5),
        ("controller.force.kp_mm_per_N", 1.1),
        ("controller.force.ki_mm_per_N_s", 7.0),
        ("controller.position.kp_per_s", 2.5),
    ],
)
def test_a_value_changed_before_the_first_tick_gives_the_run_of_an_experiment_that_has_it(
    tmp_path: Path, key: str, number: float
):
    _, changed = turned(tmp_path / "changed", Knob(lambda tuning: tuning.request(key, number)))
    _, written = turned(tmp_path / "written", Knob(lambda tuning: None), overrides=[*TOUCHING, f"{key}={number}"])
    _, before = turned(tmp_path / "before", Knob(lambda tuning: None))
    for signal in ("plant.F_ee_B", "controller.omega_ref", "controller.F_z_ref"):
        assert np.array_equal(changed[signal], written[signal])
    assert not np.array_equal(changed["plant.F_ee_B"], before["plant.F_ee_B"])


def test_gains_of_a_task_can_be_changed_like_those_of_way_points(tmp_path: Path):
    key = "controller.force.kp_mm_per_N"
    _, changed = turned(tmp_path / "changed", Knob(lambda tuning: tuning.request(key, 0.4)), "pressing", ())
    _, written = turned(tmp_path / "written", Knob(lambda tuning: None), "pressing", [f"{key}=0.4"])
    assert np.array_equal(changed["plant.F_ee_B"], written["plant.F_ee_B"])


def test_a_change_acts_from_its_tick_on_and_the_recording_says_so(tmp_path: Path):
    at = 7 * SLICE_TICKS
    run, changed = turned(tmp_path / "changed", Knob(lambda tuning: tuning.request(REFERENCE, 6), at))
    _, plain = turned(tmp_path / "plain", Knob(lambda tuning: None))
    time, force = changed.time("controller"), changed["controller.F_z_ref"]
    assert set(force[time < 0.7]) == {5.0}
    assert set(force[time >= 0.7]) == {6.0}
    earlier = plain.time("plant") < 0.7
    assert np.array_equal(changed["plant.F_ee_B"][earlier], plain["plant.F_ee_B"][earlier])
    (event,) = [event for event in changed.events if event.name == "tuning"]
    assert (event.time, event.level, event.text) == (0.7, "info", f"{REFERENCE}: 5 -> 6 (live)")
    assert event.text in [text for _, _, text in run.events]
    assert run.changed
    assert changed.metadata["changed"]["first"] == event.text
    assert "changed" not in plain.metadata


def test_of_several_wishes_between_two_slices_the_last_counts(tmp_path: Path):
    def turn(tuning: Tuning) -> None:
        for number in (9, 8, 0.1 + 0.2):
            tuning.request(REFERENCE, number)
        assert tuning.values()[REFERENCE] == 0.1 + 0.2

    run, _ = turned(tmp_path / "x", Knob(turn))
    # with every digit, so that it can be repeated
    assert [text for _, _, text in run.events if "live" in text] == [f"{REFERENCE}: 5 -> 0.30000000000000004 (live)"]


def test_a_value_that_is_there_already_is_no_change(tmp_path: Path):
    run, recording = turned(tmp_path / "x", Knob(lambda tuning: tuning.request(REFERENCE, 5)))
    assert not run.changed
    assert "changed" not in recording.metadata


@pytest.mark.parametrize(
    ("key", "number", "said"),
    [
        (REFERENCE, -1.0, "[controller.force] reference_N = -1.0: expected a number > 0"),
        (REFERENCE, 50.5, "[controller.force] reference_N = 50.5: expected a number <= 50"),
        (REFERENCE, 1e308, "expected a number <= 50"),
        ("controller.force.kp_mm_per_N", 1e308, "expected a number <= 1000"),
        ("controller.force.ki_mm_per_N_s", 1e308, "expected a number <= 10000"),
        ("controller.position.kp_per_s", 1e308, "expected a number <= 1000"),
        (REFERENCE, "6", '[controller.force] reference_N = "6": expected a number'),
        (REFERENCE, True, "[controller.force] reference_N = true: expected a number"),
        (REFERENCE, None, f"{REFERENCE}: no value; expected a number"),
        (REFERENCE, float("nan"), "[controller.force] reference_N = nan: expected a finite number"),
        ("controller.force.reference", 6.0, f"did you mean '{REFERENCE}'?"),
        ("plant.k_s", 6.0, "only these can be changed while it runs"),
    ],
)
def test_what_the_schema_refuses_in_a_file_is_refused_here(tmp_path: Path, key: str, number: object, said: str):
    def turn(tuning: Tuning) -> None:
        with pytest.raises(InputRefused) as refused:
            tuning.request(key, number)
        assert said in str(refused.value)

    run, _ = turned(tmp_path / "x", Knob(turn))
    assert not run.changed


def test_with_every_value_at_its_bound_the_numbers_stay_finite(tmp_path: Path):
    bounds = {
        REFERENCE: 50.0,
        "controller.force.kp_mm_per_N": 1000.0,
        "controller.force.ki_mm_per_N_s": 10_000.0,
        "controller.position.kp_per_s": 1000.0,
    }

    def turn(tuning: Tuning) -> None:
        assert tuning.values().keys() == bounds.keys()
        for key, number in bounds.items():
            tuning.request(key, number)

    run, recording = turned(tmp_path / "x", Knob(turn, 10 * SLICE_TICKS))
    assert np.all(np.isfinite(recording["plant.F_ee_B"]))
    # Infinity and NaN are no JSON
    json.loads((tmp_path / "x" / "summary.json").read_text(), parse_constant=pytest.fail)
    assert len([text for _, _, text in run.events if "live" in text]) == len(bounds)


def test_after_the_end_nothing_can_be_changed(tmp_path: Path):
    knob = Knob(lambda tuning: None)
    turned(tmp_path / "x", knob)
    with pytest.raises(InputRefused, match="the run is over"):
        knob.tuning.request(REFERENCE, 6)


def test_a_change_of_the_experiment_acts_within_a_slice_and_is_an_event_of_its_tick(tmp_path: Path):
    changes = "change=[{t_s = 0.734, key = 'controller.force.reference_N', value = 6.0}]"
    run, changed = turned(tmp_path / "changed", Knob(lambda tuning: None), overrides=[*TOUCHING, changes])
    time, force = changed.time("controller"), changed["controller.F_z_ref"]
    assert set(force[time < 0.7335]) == {5.0}
    assert set(force[time > 0.7335]) == {6.0}
    (event,) = [event for event in changed.events if event.name == "tuning"]
    assert (event.time, event.text) == (0.734, f"{REFERENCE}: 5 -> 6")
    # it is part of the experiment: whoever repeats that gets the same run
    assert not run.changed and "changed" not in changed.metadata


def test_a_live_change_after_one_of_the_experiment_tells_what_was_before_it(tmp_path: Path):
    changes = "change=[{t_s = 0.25, key = 'controller.force.reference_N', value = 6.0}]"
    knob = Knob(lambda tuning: tuning.request(REFERENCE, 7), 7 * SLICE_TICKS)
    _, changed = turned(tmp_path / "changed", knob, overrides=[*TOUCHING, changes])
    told = [event.text for event in changed.events if event.name == "tuning"]
    assert told == [f"{REFERENCE}: 5 -> 6", f"{REFERENCE}: 6 -> 7 (live)"]


@pytest.fixture
def fig4(root: Path) -> Path:
    return root / "experiments/fig4_force_position.toml"


def test_the_size_is_that_of_a_recording_to_a_third(fig4: Path, force_position: Recording):
    _, size = estimate(load_experiment(fig4))
    # the content of signals decides how far they compress
    assert size == pytest.approx(force_position.path.stat().st_size, rel=1 / 3)


def test_at_the_controllers_rate_half_is_estimated(fig4: Path):
    seconds, size = estimate(load_experiment(fig4))
    assert estimate(load_experiment(fig4, ["recording.rate=controller"])) == (seconds, size / 2)


def test_a_run_that_fills_the_disk_is_asked_about_before_it_begins(fig4: Path, tmp_path: Path):
    done = twin("run", fig4, "--set", "duration_s=1e7", "--isolate", "none", cwd=tmp_path)
    assert done.returncode == 2 and not any(tmp_path.iterdir())
    assert done.stderr == (
        "fig4_force_position: would take about 2.3 days and 3,500 GB; "
        "--yes runs it anyway, --set duration_s=... shortens it\n"
    )


def test_several_runs_count_together_and_pacing_counts_too(fig4: Path):
    hour = load_experiment(fig4, ["duration_s=1800", "reference.t_s=[0]", "reference.p_mm=[[0, 0, -90]]"])
    refuse_endless([hour])
    refuse_endless([hour], factor=1.0)
    with pytest.raises(InputRefused, match="60 minutes and 1 GB"):
        refuse_endless([hour], factor=0.499)
    count = int(MAX_DISK_BYTES / estimate(hour)[1]) + 1
    with pytest.raises(InputRefused, match="5 GB"):
        refuse_endless([hour] * count)


def test_a_sweep_of_endless_runs_is_asked_about_even_before_it_is_estimated(fig4: Path, tmp_path: Path):
    (tmp_path / "long.toml").write_text(f'extends = "{fig4}"\nduration_s = 1e7\n')
    (tmp_path / "sweep.toml").write_text(
        'experiment = "long.toml"\n[[vary]]\nkey = "contact.stiffness_N_per_m"\nvalues = [1000.0, 2000.0]\n'
    )
    for options in ([], ["--dry-run"]):
        done = twin("sweep", "run", "sweep.toml", *options, cwd=tmp_path)
        assert done.returncode == 2 and done.stderr.startswith(
            "sweep: each run takes about 56 hours; shorten duration_s"
        )


JUMP_UP = ("contact.shift.by_mm=[0, 0, 8]", "contact.shift.start_s=3", "contact.shift.rise_s=0.05")
"""A person who rises by 8 mm within 50 ms."""


def fault(kind: str, onset: float, **values: float) -> str:
    keys = "".join(f", {key}={value}" for key, value in values.items())
    return f"fault=[{{kind='{kind}', onset_s={onset}{keys}}}]"


def ran(folder: Path, name: str, *overrides: str) -> tuple[Run, Recording]:
    run = execute(shipped(name, *overrides), folder)
    return run, read(run.recording)


def told(recording: Recording, *levels: str) -> list[tuple[float, str]]:
    return [(event.time, event.text) for event in recording.events if event.level in levels]


@pytest.fixture(scope="module")
def massage(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Recording]:
    return ran(tmp_path_factory.mktemp("massage"), "massage")


def test_every_task_is_announced_when_it_begins(massage: tuple[Run, Recording]):
    _, recording = massage
    time, task = recording.time("controller"), recording["controller.task"]
    begins = [float(time[np.argmax(task == number)]) for number in (1, 2, 3, 4)]
    names = ("press", "tap", "roll", "push")
    expected = [f"task {n} ({name}) of 4 begins" for n, name in enumerate(names, start=1)]
    assert told(recording, "info") == list(zip(begins, expected, strict=True))


def test_every_phase_is_told_for_debugging_at_the_tick_in_which_it_begins(massage: tuple[Run, Recording]):
    _, recording = massage
    time, both = recording.time("controller"), np.stack([recording["controller.task"], recording["controller.phase"]])
    changes = np.flatnonzero(np.any(np.diff(both, axis=1, prepend=0) != 0, axis=0))
    names = dict(enumerate(("press", "tap", "roll", "push"), start=1))
    expected = [
        (float(time[k]), f"task {both[0, k]} ({names[both[0, k]]}): {PhaseKind(both[1, k]).phrase}") for k in changes
    ]
    assert told(recording, "debug") == expected
    assert len(expected) > 40


def test_a_massage_in_which_all_goes_well_has_nothing_to_warn_of(massage: tuple[Run, Recording]):
    run, recording = massage
    assert told(recording, "warning", "error", "fatal") == []
    assert run.trip == ""


def test_events_are_in_order_of_time_and_the_same_in_recording_and_summary(massage: tuple[Run, Recording]):
    run, recording = massage
    times = [event.time for event in recording.events]
    assert times == sorted(times)
    found = [(event.time, event.level.upper(), event.text) for event in recording.events]
    # times are ticks in both, once in ns and once as a product of floats
    assert [event[1:] for event in run.events] == [event[1:] for event in found]
    np.testing.assert_allclose([event[0] for event in run.events], times, rtol=0, atol=1e-9)


def test_the_recording_says_what_the_numbers_of_the_phases_mean(massage: tuple[Run, Recording]):
    _, recording = massage
    assert recording.metadata["phases"] == {str(kind.value): kind.phrase for kind in PhaseKind}
    assert recording.metadata["phases"]["3"] == "build-up"


def test_a_trip_is_an_error_at_its_tick_with_its_sentence(tmp_path: Path):
    run, recording = ran(tmp_path, "pressing", *JUMP_UP, "duration_s=12")
    tripped = recording.time("monitor")[np.argmax(recording["monitor.tripped"])]
    (event,) = told(recording, "error")
    assert event == (tripped, run.trip)
    assert 3.0 < tripped < 3.1
    assert run.trip.startswith("safety monitor: ")
    assert recording.complete


def test_power_taken_away_is_an_error_after_the_trip(tmp_path: Path):
    run, recording = ran(tmp_path, "pressing", fault("drive_runaway", 4.0, magnitude_rad_per_s=2.0))
    trip, power = told(recording, "error")
    assert trip[1] == run.trip
    off = recording.time("monitor")[np.argmin(recording["monitor.power"])]
    assert power == (off, "safety monitor: the motors do not retract; power taken away")
    # the motor turns faster than anything commanded: the power is cut at the trip
    assert 4.0 < trip[0] == off


def test_a_fault_is_a_warning_when_it_begins_and_when_it_ends(tmp_path: Path):
    _, recording = ran(tmp_path, "pressing", fault("breathing", 3.25, duration_s=1.5, magnitude_mm=0.5))
    assert told(recording, "warning") == [
        (3.25, "fault 1 (breathing of contact) begins"),
        (4.75, "fault 1 (breathing of contact) ends"),
    ]


def test_a_fault_that_stays_does_not_end(tmp_path: Path):
    _, recording = ran(tmp_path, "pressing", fault("breathing", 3.25, magnitude_mm=0.5))
    assert told(recording, "warning") == [(3.25, "fault 1 (breathing of contact) begins")]


@pytest.mark.parametrize(
    ("name", "loss", "said"),
    [
        ("pressing", fault("contact_loss", 6.0, magnitude_mm=40), "task 1 (press) lost contact"),
        (
            "pressing",
            fault("contact_loss", 0.0, magnitude_mm=40),
            "task 1 (press) felt nothing down to the floor of the approach",
        ),
        (
            "tapping",
            # 1.5 mm over the floor there is a surface that gives 1.9 N there
            fault("contact_loss", 0.0, magnitude_mm=27.5),
            "task 1 (tap) did not reach the force down to the floor of the approach",
        ),
    ],
    ids=["lost", "nothing felt", "probe"],
)
def test_a_task_that_is_cut_short_is_warned_of(tmp_path: Path, name: str, loss: str, said: str):
    _, recording = ran(tmp_path, name, loss, "monitor.enabled=false")
    (_, begun), (at, warned), *_ = told(recording, "warning")
    assert begun == "fault 1 (contact_loss of contact) begins"
    assert warned == said
    # it is the very moment at which the robot begins to retract
    retracts = [time for time, text in told(recording, "debug") if text.endswith(": retract")]
    assert at in retracts


def test_a_probe_that_reached_its_force_is_not_warned_of(massage: tuple[Run, Recording]):
    _, recording = massage
    assert any(text == "task 2 (tap): probe" for _, text in told(recording, "debug"))
    assert not any("did not reach" in event.text for event in recording.events)


def test_what_a_drive_logs_is_a_warning_at_the_tick_of_its_step(root: Path, tmp_path: Path):
    fmu = warning_drive(root, tmp_path, 0.25)
    folder = tmp_path / "run"
    folder.mkdir()
    _, recording = ran(folder, "fig4_position", "duration_s=1", f"drive.joint_2.fmu='{fmu}'")
    assert told(recording, "warning") == [(0.25, "the winding is hot")]


def test_broken_and_healthy_counts_are_recorded_beside_each_other(tmp_path: Path):
    bias = fault("encoder_bias", 3.0, duration_s=0.1, magnitude_deg=0.5)
    _, recording = ran(tmp_path, "pressing", bias, "monitor.enabled=false")
    off = recording["fault/1.count_l"] - recording["encoder.count_l"]
    active = recording["fault/1.active"] == 1.0
    t = recording.time("fault/1")
    np.testing.assert_array_equal(active, (t >= 3.0) & (t < 3.1))
    # 0.5 deg of 16384 counts per turn, to the nearest count
    np.testing.assert_array_equal(off[active], np.tile([23.0, 0.0, 0.0], (active.sum(), 1)))
    assert not off[~active].any()


STIFF = "plant.k_s_Nm_per_rad=3"
"""A spring three times as stiff as believed: the weight it carries reads as a press of 1.4 N in the air."""


def test_a_force_loop_that_is_on_before_the_first_touch_is_warned_of_then_and_at_the_touch(tmp_path: Path):
    _, recording = ran(tmp_path, "fig4_force_position", STIFF, "duration_s=4")
    t, F_z = recording.time("plant"), -recording["plant.F_ee_B"][:, 2]
    touch = float(t[np.argmax(F_z > 0.0)])
    trigger = float(recording.time("controller")[np.argmax(recording["controller.triggered"])])
    assert trigger < touch - 2.0
    lead = f"first touch: the force loop was triggered {touch - trigger:.3f} s before it"
    early = (trigger, "the force loop is on before the first touch")
    assert told(recording, "warning") == [early, (pytest.approx(touch, abs=1e-9), lead)]


def test_a_force_loop_that_never_touches_is_warned_of_once_and_one_triggered_in_contact_never(tmp_path: Path):
    for name, overrides, expected in (("never", (STIFF, "duration_s=1"), 1), ("contact", ("duration_s=6",), 0)):
        (tmp_path / name).mkdir()
        _, recording = ran(tmp_path / name, "fig4_force_position", *overrides)
        assert recording["controller.triggered"][-1]
        assert len(told(recording, "warning")) == expected


def test_where_belief_and_plant_share_a_stiff_spring_a_pull_in_the_air_triggers_nothing(tmp_path: Path):
    # its estimate is three times as coarse: -0.6 N in the air, which a trigger by size took for a press at 0.5 s
    _, recording = ran(tmp_path, "fig4_force_position", STIFF, "controller.model.k_s_Nm_per_rad=3", "duration_s=7")
    F_z = recording["controller.F_z"]
    trigger = int(np.argmax(recording["controller.triggered"]))
    assert F_z[:trigger].min() < -0.6 and F_z[trigger] > 0.6
    assert told(recording, "warning") == []
