import math

from tests.robot.monitor.motions import LIMITS
from twin.robot.monitor.checks import thresholds
from twin.robot.monitor.reasons import REASON_COUNT, REASON_TEXTS, Reason, Trip, trip_message


def test_every_reason_says_what_it_means():
    assert set(REASON_TEXTS) == set(Reason) - {Reason.NONE}
    assert len({meaning.sentence for meaning in REASON_TEXTS.values()}) == len(REASON_TEXTS)


def test_codes_are_the_places_of_their_limits():
    assert [int(reason) for reason in Reason] == list(range(REASON_COUNT))
    limit, rest = thresholds(LIMITS)
    assert limit[Reason.FORCE] == LIMITS.force_limit
    assert limit[Reason.STALE] == LIMITS.stale_time
    assert limit[Reason.FOLLOW] == LIMITS.follow_time
    assert limit[Reason.HIDDEN_FORCE] == LIMITS.hidden_time
    assert rest[Reason.TOO_LOW] == rest[Reason.TOO_HIGH] == 0.5 * (LIMITS.z_min + LIMITS.z_max)


def test_a_sentence_names_who_what_and_the_limit_in_units_for_people():
    jammed = Trip(tick=7, reason=Reason.FOLLOW, value=0.102, limit=0.1, joint=2)
    assert trip_message(jammed) == (
        "safety monitor: joint 2: the motor does not follow its command: for 102 ms, limit 100 ms"
    )
    deflection = Trip(tick=7, reason=Reason.DEFLECTION, value=math.radians(21.0), limit=math.radians(20.0), joint=1)
    assert trip_message(deflection).endswith("deflection 21 deg, limit 20 deg")
    bent = Trip(tick=7, reason=Reason.NO_POSE, value=1.0, limit=1.0, joint=0)
    assert trip_message(bent) == ("safety monitor: the joint angles fit no pose of the robot: unfit samples 1, limit 1")
    assert "invalid values 2, limit 1" in trip_message(Trip(0, Reason.INVALID_SAMPLE, 2.0, 1.0, 0))
    assert "rate 320 N/s, limit 300 N/s" in trip_message(Trip(0, Reason.FORCE_RATE, 320.0, 300.0, 0))
