import numpy as np
import pytest

from tests.kernel.cosim.models import sampled
from tests.robot.faults.robot import COUNTS, SPEED_LIMIT, TICK, Robot, plant, run
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.system import End, Feeds
from twin.kernel.errors import InputRefused
from twin.robot import faults, shaft
from twin.robot.assembly.declared import FAULT_PLACES
from twin.robot.assembly.inject import COUNT_LAWS, DRIVE_LAWS, inject
from twin.robot.experiment.fault import FAULT_KINDS, Fault

DEG = np.pi / 180.0
TURN = 2.0 * np.pi
ONSET, END = 40, 80


def injected(faults: list[Fault], robot: Robot | None = None) -> tuple[list[Component], Feeds]:
    return inject(*(robot or Robot()).parts(), faults, TICK, COUNTS, SPEED_LIMIT)


def names(faults: list[Fault], robot: Robot | None = None) -> list[str]:
    return [component.name for component in injected(faults, robot)[0]]


@pytest.mark.slow
def test_what_is_given_stays_as_it_is():
    components, feeds = Robot().parts()
    given = (list(components), dict(feeds))
    inject(components, feeds, [Fault("encoder_flip", "joint_encoder_1", 0)], TICK, COUNTS, SPEED_LIMIT)
    assert (components, feeds) == given


def test_without_faults_nothing_changes():
    components, feeds = Robot().parts()
    assert inject(components, feeds, [], TICK, COUNTS, SPEED_LIMIT) == (components, feeds)


def test_faults_are_numbered_as_in_the_list_whatever_their_mechanism():
    faults = [
        Fault("breathing", "contact", 0, magnitude=0.001),
        Fault("encoder_flip", "joint_encoder_1", 0),
        Fault("spring_broken", "joint_1", 0),
    ]
    assert {name for name in names(faults) if name.startswith("fault")} == {"fault_2", "fault_3"}


def test_parameters_come_first_and_everything_else_right_behind_what_feeds_it():
    faults = [
        Fault("encoder_flip", "joint_encoder_1", 0),
        Fault("spring_broken", "joint_1", 0),
        Fault("encoder_flip", "joint_encoder_2", 0),
        Fault("belief_k_s", "estimator", 0, magnitude=1.1),
        Fault("drive_dead", "drive_2", 0),
        Fault("drive_saturation", "drive_2", 0, magnitude=1.0),
        Fault("controller_overrun", "controller", 0, magnitude=TICK),
    ]
    assert names(faults, Robot(power_off=100)) == [
        "fault_2", "fault_4", "encoder", "fault_1", "fault_3", "estimator", "controller", "fault_7", "monitor",
        "fault_6", "drive_1", "drive_2", "fault_5", "drive_3", "plant",
    ]  # fmt: skip


@pytest.mark.parametrize("kind", ["encoder_dropout_nan", "sample_delay"])
def test_counts_that_may_be_no_numbers_are_recorded_as_doubles(kind):
    target = "encoder" if kind == "sample_delay" else "joint_encoder_1"
    components, _ = injected([Fault(kind, target, 0, magnitude=TICK)])
    fault = next(component for component in components if component.name == "fault_1")
    assert {port.name: port.kind for port in fault.outputs}["count_l"] == "double"


def test_every_reader_gets_the_faulty_signal_also_one_that_reads_a_single_element():
    components, feeds = Robot().parts()
    del feeds[End("estimator", "count_l", 0)], feeds[End("estimator", "count_l", 2)]
    fault = Fault("encoder_flip", "joint_encoder_2", 0)
    _, feeds = inject(components, feeds, [fault], TICK, COUNTS, SPEED_LIMIT)
    readers = {target for target, source in feeds.items() if source[:2] == ("encoder", "count_l")}
    assert readers == {End("fault_1", "count_l", i) for i in range(3)}
    assert feeds[End("estimator", "count_l", 1)] == End("fault_1", "count_l", 1)


def test_the_recording_keeps_both_signals():
    done = run(Fault("encoder_flip", "joint_encoder_2", 0))
    np.testing.assert_array_equal(done["fault_1.count_l"][:, 1], -done["encoder.count_l"][:, 1])


def test_faults_on_one_wire_act_in_the_order_of_the_list():
    bias = Fault("encoder_bias", "joint_encoder_1", 0, magnitude=TURN)
    flip = Fault("encoder_flip", "joint_encoder_1", 0)
    clean = run()["encoder.count_l"][:, 0]
    np.testing.assert_array_equal(run(bias, flip)["estimator.read"][:, 3], -(clean + COUNTS[1]))
    np.testing.assert_array_equal(run(flip, bias)["estimator.read"][:, 3], -clean + COUNTS[1])


def test_faults_of_counts_and_of_messages_chain():
    late = Fault("sample_delay", "encoder", 0, magnitude=4 * TICK)
    flip = Fault("encoder_flip", "joint_encoder_1", 0)
    for both in ([late, flip], [flip, late]):
        done = run(*both)
        np.testing.assert_array_equal(done["estimator.read"][4:, 3], -done["encoder.count_l"][:-4, 0])
        np.testing.assert_array_equal(done["estimator.read"][4:, 6], done["encoder.sample"][:-4, 0])


@pytest.mark.parametrize("robot", [Robot(), Robot(True), Robot(power_off=50), Robot(True, 50)])
def test_all_faults_of_all_joints_at_once_make_a_system(robot):
    faults = [
        Fault(kind, f"{where}_{i}", 10 * i, 60, 0.5, 0.3)
        for kind, where in [
            ("encoder_bias", "joint_encoder"), ("encoder_glitch", "motor_encoder"), ("encoder_swap", "motor_encoder"),
            ("spring_softened", "joint"), ("drive_runaway", "drive"), ("drive_freewheel", "drive"),
            ("drive_saturation", "drive"), ("joint_jam", "drive"),
        ]
        for i in (1, 2, 3)
    ]  # fmt: skip
    faults += [Fault("brown_out", "drives", 0, 60, 0.5), Fault("sample_jitter", "encoder", 0, 60, 0.01)]
    faults += [Fault("controller_overrun", "controller", 0, 60, 0.01), Fault("stiffness_change", "contact", 0, 60, 2.0)]
    assert np.isfinite(run(*faults, robot=robot).rows).all()


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (Fault("encoder_bais", "joint_encoder_1", 0), "kind = \"encoder_bais\": did you mean 'encoder_bias'"),
        (Fault("zzz", "joint_encoder_1", 0), "no such kind; docs/faults_reference.md lists them all"),
        (Fault("drive_dead", "drive_4", 0), "target = \"drive_4\" of drive_dead: expected 'drive_1', "),
        (Fault("encoder_flip", "drive_1", 0), "expected 'joint_encoder_1', 'joint_encoder_2', 'joint_encoder_3'"),
    ],
)
def test_an_unknown_kind_or_target_is_refused_with_the_number_of_the_fault(fault, said):
    with pytest.raises(InputRefused) as refusal:
        injected([Fault("spring_broken", "joint_1", 0), fault])
    assert str(refusal.value).startswith("[[fault]] 2 ")
    assert said in str(refusal.value)


def test_a_target_that_the_system_does_not_have_is_refused():
    components, feeds = Robot().parts()
    rest = [component for component in components if component.name != "drive_2"]
    with pytest.raises(InputRefused) as refusal:
        inject(rest, feeds, [Fault("drive_dead", "drive_2", 0)], TICK, COUNTS, SPEED_LIMIT)
    assert str(refusal.value) == (
        "[[fault]] 1 target = \"drive_2\": expected a system with a component 'drive_2'; there are encoder, estimator, "
        "controller, drive_1, drive_3, plant. Change the target or add what it names"
    )


@pytest.mark.parametrize(
    ("mechanism", "kinds"), [("counts", COUNT_LAWS), ("drive", DRIVE_LAWS), ("parameter", FAULT_PLACES)]
)
def test_each_mechanism_does_its_kinds_and_no_others(mechanism, kinds):
    assert set(kinds) == {name for name, known in FAULT_KINDS.items() if known.mechanism == mechanism}


@pytest.mark.parametrize(("laws", "known"), [(COUNT_LAWS, faults.CountLaw), (DRIVE_LAWS, shaft.DriveLaw)])
def test_each_law_belongs_to_one_kind(laws, known):
    assert sorted(laws.values()) == sorted(known)


@pytest.mark.parametrize(
    ("kind", "degrees", "least"),
    [("encoder_bias", 0.04, "0.5"), ("encoder_glitch", -0.04, "0.5"), ("encoder_quantisation", 0.1, "2")],
)
def test_a_magnitude_that_changes_no_count_is_refused(kind, degrees, least):
    with pytest.raises(InputRefused, match=rf"\[\[fault\]\] 1: {kind} of .* deg changes no count .* {least} counts"):
        run(Fault(kind, "motor_encoder_1", ONSET, END, np.radians(degrees), share=0.1))


@pytest.mark.parametrize("milliseconds", [0.4, 1.5])
def test_a_delay_that_is_no_whole_tick_is_refused(milliseconds):
    with pytest.raises(InputRefused, match=rf"\[\[fault\]\] 1: sample_delay of {milliseconds} ms; expected a whole"):
        run(Fault("sample_delay", "encoder", ONSET, END, milliseconds * 1e-3))


def test_a_plant_without_the_parameter_is_refused():
    parts, wires = Robot().parts()
    ports = plant().inputs
    mute = sampled("plant", lambda t, h, u: np.zeros(19), ports, outputs=plant().outputs)
    with pytest.raises(InputRefused) as refusal:
        inject([*parts[:-1], mute], wires, [Fault("joint_friction", "joint_1", 0)], TICK, COUNTS, SPEED_LIMIT)
    assert str(refusal.value) == (
        "[[fault]] 1: joint_friction writes parameters.b_j_added in the memory of component 'plant', which has none; "
        "remove the fault or use the native plant"
    )
