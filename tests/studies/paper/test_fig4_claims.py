"""Every claim of Fig. 4 on hand-written runs: it holds just inside its bound, and just outside it fails alone."""

from typing import Any

import numpy as np
import pytest

from tests.studies.paper.fig4_series import T, runs
from twin.studies.paper.claim import ClaimFinding, judge_claim
from twin.studies.paper.fig4 import FIG4_CLAIMS, QUALITY_CLAIMS, fig4_score
from twin.studies.paper.fig4_measures import SWEEP_WINDOW, Fig4Runs, disproportion, fluctuation, position_jump
from twin.studies.paper.fig5 import TASK_CLAIMS as FIG5

BY_KEY = {claim.key: claim for claim in (*FIG4_CLAIMS, *QUALITY_CLAIMS)}
WHILE_SWEEPING = {
    "sweep_ends", "sweep_speed", "sweep_line", "force_tracks",
    "position_error", "position_below", "estimate_bias", "force_unchanged", "x_small", "friction_smaller_x",
    "friction_smaller", "fluctuation", "fluctuation_small", "fluctuation_survived", "true_force", "true_z",
}  # fmt: skip

# key, which bound, flaws just inside it, flaws just outside
NEAR: list[tuple[str, str, dict[str, Any], dict[str, Any]]] = [
    ("sweep_ends", "high", {"p": {"y_before": 1.9e-3}}, {"p": {"y_before": 2.1e-3}}),
    ("sweep_ends", "high", {"fp": {"y_after": -1.9e-3}}, {"fp": {"y_after": -2.1e-3}}),
    # 4 mm/s: in 1 s a wave of amplitude a adds 2 a to 4 mm, and a little to their mean
    ("sweep_speed", "high", {"p": {"wave": 0.18e-3}}, {"p": {"wave": 0.20e-3}}),
    ("sweep_line", "high", {"p": {"x": 0.49e-3}}, {"p": {"x": 0.51e-3}}),
    ("sweep_line", "high", {"both": {"z_ref": 0.49e-3}}, {"both": {"z_ref": 0.51e-3}}),
    ("reference_force", "low", {"fp": {"F_z_ref": 4.96}}, {"fp": {"F_z_ref": 4.94}}),
    ("reference_force", "high", {"fp": {"F_z_ref": 5.04}}, {"fp": {"F_z_ref": 5.06}}),
    ("reference_overlaps", "high", {"fp": {"apart": 0.09e-3}}, {"fp": {"apart": 0.11e-3}}),
    ("trigger_time", "low", {"fp": {"trigger": 5.41}}, {"fp": {"trigger": 5.39}}),
    ("trigger_time", "high", {"fp": {"trigger": 5.79}}, {"fp": {"trigger": 5.81}}),
    ("trigger_force", "low", {"fp": {"F_trigger": 0.601}}, {"fp": {"F_trigger": 0.599}}),
    ("trigger_force", "high", {"fp": {"F_trigger": 0.649}}, {"fp": {"F_trigger": 0.651}}),
    # 0.3 mm of it stays
    ("reference_jumps", "low", {"fp": {"jump": 1.71e-3}}, {"fp": {"jump": 1.69e-3}}),
    ("reference_jumps", "high", {"fp": {"jump": 14.69e-3}}, {"fp": {"jump": 14.71e-3}}),
    ("reference_jumps", "low", {"fp": {"after": 0.08}}, {"fp": {"after": 0.12}}),
    ("position_jumps", "low", {"fp": {"faster": 2.02}}, {"fp": {"faster": 1.98}}),
    ("reference_returns", "high", {"fp": {"left": 0.49e-3}}, {"fp": {"left": 0.51e-3}}),
    ("z_trend", "low", {"p": {"swing": 6.8e-3}}, {"p": {"swing": 7.4e-3}}),
    ("force_tracks", "high", {"fp": {"force": -0.24}}, {"fp": {"force": -0.26}}),
    # it rises by 3.6 N from 0.6 N on
    ("force_rises", "low", {"p": {"sag": 0.38}}, {"p": {"sag": 0.42}}),
    ("position_late", "low", {"p": {"late": 0.52}}, {"p": {"late": 0.48}}),
    # 0.2 N off with force control, less what the fluctuation takes off
    ("position_error", "low", {"fp": {"force": -0.2}, "p": {"force": 4.61}},
     {"fp": {"force": -0.2}, "p": {"force": 4.62}}),
    ("position_below", "low", {"p": {"force": 4.89}}, {"p": {"force": 4.91}}),
    ("estimate_bias", "low", {"fp": {"bias": -0.24}}, {"fp": {"bias": -0.26}}),
    ("estimate_bias", "high", {"fp": {"bias": 0.24}}, {"fp": {"bias": 0.26}}),
    ("scale_linear", "high", {"p": {"bend": 0.048}}, {"p": {"bend": 0.052}}),
    ("scale_linear", "high", {"p": {"bend": -0.048}}, {"p": {"bend": -0.052}}),
    ("force_unchanged", "high", {"p": {"wobble": 0.24}}, {"p": {"wobble": 0.26}}),
    ("x_small", "high", {"x_fp": {"friction": (0.27, -1.1)}}, {"x_fp": {"friction": (0.28, -1.1)}}),
    ("x_small", "high", {"x_fp": {"friction": (0.27, -1.1)}, "x_p": {"friction": (0.24, -1.0)}},
     {"x_fp": {"friction": (0.27, -1.1)}, "x_p": {"friction": (0.24, -0.95)}}),
    ("friction_smaller_x", "high", {"x_p": {"friction": (0.097, -1.0)}}, {"x_p": {"friction": (0.099, -1.0)}}),
    ("friction_smaller", "high", {"p": {"friction": (0.0, -1.07)}}, {"p": {"friction": (0.0, -1.085)}}),
    ("fluctuation", "low", {"fp": {"fluctuation": (13.21, 0.05)}}, {"fp": {"fluctuation": (13.19, 0.05)}}),
    ("fluctuation", "high", {"fp": {"fluctuation": (14.19, 0.05)}}, {"fp": {"fluctuation": (14.21, 0.05)}}),
    ("fluctuation_small", "high", {"fp": {"fluctuation": (13.7, 0.24)}}, {"fp": {"fluctuation": (13.7, 0.26)}}),
    ("fluctuation_survived", "high", {"fp": {"noise": 0.22 * (np.abs(T - 14.6) < 0.005)}},
     {"fp": {"noise": 0.23 * (np.abs(T - 14.6) < 0.005)}}),
    # the force is half of the fluctuation too low before it; what it does is looked at from 13.2 s on
    ("fluctuation_survived", "high", {"fp": {"noise": -0.23 * (np.abs(T - 13.19) < 0.005)}},
     {"fp": {"noise": -0.23 * (np.abs(T - 13.21) < 0.005)}}),
    ("early_trigger", "high", {"fp": {"touch": 5.6}}, {"fp": {"touch": 5.61}}),
    ("true_force", "high", {"fp": {"true": -0.24}}, {"fp": {"true": -0.26}}),
    ("true_overshoot", "high", {"fp": {"peak": 0.24}}, {"fp": {"peak": 0.26}}),
    ("true_final", "low", {"fp": {"final": 4.76}}, {"fp": {"final": 4.74}}),
    ("true_final", "high", {"fp": {"final": 5.24}}, {"fp": {"final": 5.26}}),
    ("true_z", "high", {"fp": {"true_z": 0.59e-3}}, {"fp": {"true_z": 0.61e-3}}),
]  # fmt: skip
ALSO = {
    ("true_final", "high"): {"true_overshoot"},
    ("z_trend", "low"): {"z_place", "z_same"},
}
"""What cannot be apart: a force too large at the end is too large at all; a height with another trend is off."""
# key, flaws with which it is reproduced after all, is not, and is worse than is known; what fails besides then
KNOWN: list[tuple[str, dict[str, Any], dict[str, Any], dict[str, Any], set[str]]] = [
    ("z_tracks_position", {"p": {"lag": 0.12}}, {"p": {"lag": 0.14}},
     {"p": {"lag": 0.62, "above": 0.4e-3}, "fp": {"above": 2.3e-3}}, set()),
    # a height that lags longer than is known is off by more as well
    ("z_lag", {"p": {"lag": 0.49}, "fp": {"above": 1.9e-3}}, {"p": {"lag": 0.51}, "fp": {"above": 1.9e-3}},
     {"p": {"lag": 0.76}, "fp": {"above": 2.3e-3}}, {"z_tracks_position"}),
    ("z_place", {"p": {"z": 0.49e-3}}, {"p": {"z": 0.51e-3}}, {"p": {"z": 1.11e-3}}, set()),
    ("z_tracks", {"fp": {"above": 0.48e-3}}, {"fp": {"above": 0.51e-3}},
     {"fp": {"above": 2.7e-3}, "p": {"lag": 0.5}}, set()),
    ("z_same", {"fp": {"z": -0.09e-3}}, {"fp": {"z": -0.11e-3}}, {"fp": {"z": -0.71e-3}}, set()),
]  # fmt: skip


def test_runs_as_they_are_meant_to_be_hold_every_claim():
    score = fig4_score(runs())
    verdicts = {f.claim.key: f.verdict for f in (*score.claims, *score.quality)}
    after_all = {key for key, verdict in verdicts.items() if verdict == "reproduced after all"}
    assert after_all == set(score.reproduced_keys) == {key for key, *_ in KNOWN}
    assert score.not_reproduced_keys == ["backlash_offset"]
    assert {verdict for key, verdict in verdicts.items() if key not in after_all | {"backlash_offset"}} == {"holds"}


@pytest.mark.parametrize(("key", "holds", "missed", "beyond", "also"), KNOWN, ids=[row[0] for row in KNOWN])
def test_what_is_known_not_to_be_reproduced_fails_where_it_is_worse_than_its_reason_explains(
    key: str, holds: dict, missed: dict, beyond: dict, also: set[str]
):
    verdicts = [judge_claim(BY_KEY[key], runs(**flaws)).verdict for flaws in (holds, missed, beyond)]
    assert verdicts == ["reproduced after all", "not reproduced", "fails"]
    assert fig4_score(runs(**holds)).failed_keys == fig4_score(runs(**missed)).failed_keys == []
    assert set(fig4_score(runs(**beyond)).failed_keys) == {key} | also


def test_every_claim_that_is_measured_and_known_to_be_missed_has_such_runs_and_a_reason():
    missed = [claim for claim in BY_KEY.values() if claim.miss or claim.measure is None]
    assert all(claim.miss and claim.miss.reason for claim in missed)
    measured = [claim for claim in missed if claim.measure]
    assert {claim.key for claim in measured} == {key for key, *_ in KNOWN}
    assert all(claim.miss and np.isfinite(claim.miss.high) for claim in measured)


@pytest.mark.parametrize(("key", "bound", "inside", "outside"), NEAR, ids=[f"{row[0]}-{row[1]}" for row in NEAR])
def test_a_claim_holds_inside_its_bound_and_outside_fails_alone(key: str, bound: str, inside: dict, outside: dict):
    assert set(fig4_score(runs(**inside)).failed_keys) <= ALSO.get((key, bound), set())
    assert set(fig4_score(runs(**outside)).failed_keys) == {key} | ALSO.get((key, bound), set())
    value, claim = judge_claim(BY_KEY[key], runs(**outside)).value, BY_KEY[key]
    assert value < claim.low if bound == "low" else value > claim.high


def test_no_bound_is_without_runs_on_both_sides_of_it():
    bounds = {
        (claim.key, name)
        for claim in BY_KEY.values()
        for name in ("low", "high")
        if claim.measure is not None and claim.miss is None and np.isfinite(getattr(claim, name))
    }
    assert {(key, bound) for key, bound, *_ in NEAR} == bounds


def test_without_a_sweep_every_claim_of_the_sweep_fails_and_none_says_nothing():
    score = fig4_score(runs(both={"sweeps": False}))
    assert set(score.failed_keys) == WHILE_SWEEPING
    assert "trivial" not in {f.verdict for f in score.claims}


@pytest.mark.parametrize("which", ["fp", "p"])
def test_one_run_that_does_not_sweep_is_enough_to_fail(which: str):
    assert set(fig4_score(runs(**{which: {"sweeps": False}})).failed_keys) >= WHILE_SWEEPING - {
        "x_small",
        "friction_smaller_x",
    }


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("size", [0.003, 0.03, 0.1])
def test_noise_is_no_fluctuation(seed: int, size: float):
    noise = size * np.random.default_rng(seed).standard_normal(len(T))
    assert np.isnan(fluctuation(runs(fp={"fluctuation": (13.7, 0.0), "noise": noise}).force_position)).all()


def test_a_fluctuation_is_seen_in_noise_an_eighth_of_its_size():
    noise = 0.006 * np.random.default_rng(1).standard_normal(len(T))
    time, size = fluctuation(runs(fp={"noise": noise}).force_position)
    # over 0.2 s, 20 samples, 0.006 N of noise leave 0.006 sqrt(2/20) = 0.002 N; three of these
    assert time == pytest.approx(13.7, abs=0.05) and size == pytest.approx(0.05, abs=0.006)


@pytest.mark.parametrize("size", [0.0, 0.019])
def test_no_fluctuation_fails_both_claims_of_it_and_no_other(size: float):
    assert set(fig4_score(runs(fp={"fluctuation": (13.7, size)})).failed_keys) == {"fluctuation", "fluctuation_small"}


def test_a_drift_is_no_fluctuation():
    drift = runs(fp={"fluctuation": (13.7, 0.0), "noise": 0.2 * (T - 14.7) / 4.0}).force_position
    assert np.isnan(fluctuation(drift)).all()


@pytest.mark.parametrize(("times", "found"), [(9.7, False), (10.3, True)])
def test_a_fluctuation_is_ten_times_what_the_force_does_anyway(times: float, found: bool):
    # a drift of 0.025 N/s changes the mean over 0.2 s by 0.005 N from one to the next, and so adds to the fluctuation
    drift, each = 0.025 * (T - 13.7), 0.005
    run = runs(fp={"fluctuation": (13.7, (times - 1.0) * each), "noise": drift}).force_position
    assert np.isfinite(fluctuation(run)).all() == found


def test_a_way_or_a_reading_that_ends_below_its_beginning_is_in_proportion_to_nothing():
    rising, unloaded = runs().position, runs().position
    before = T < SWEEP_WINDOW[0]
    rising.recording["estimator.p_B"][before, 2] *= -1.0
    unloaded.recording["scale.F_z"][np.flatnonzero(before)[-1]] = -0.1
    for position in (rising, unloaded):
        assert np.isnan(disproportion(Fig4Runs(runs().force_position, position)))


def test_the_line_begins_where_the_scale_first_reads_a_press_if_it_does():
    whole, pulled, never, at_once = (runs().position for _ in range(4))
    pulled.recording["scale.F_z"][100] = -0.1
    never.recording["scale.F_z"][T < SWEEP_WINDOW[0]] = 0.0
    at_once.recording["scale.F_z"][0] = 0.1
    found = [disproportion(Fig4Runs(runs().force_position, one)) for one in (whole, pulled, never, at_once)]
    assert found[0] == found[1] > 0.0 and np.isnan(found[2:]).all()


DIGITS = {"%": 1, "mm": 2, "N": 2, "s": 2, "": 2}
FINER = {"early_trigger", "trigger_time", "trigger_force", "fluctuation_small", "true_force", "true_z"}


def test_numbers_are_printed_to_the_digits_that_mean_something_in_their_unit():
    for claim in BY_KEY.values():
        # a number without end, of which the claim says how much is printed
        printed = ClaimFinding(claim, 1.0 / 3.0, "holds", "").measured_text
        digits = len(printed.partition(" ")[0].partition(".")[2])
        assert not printed or digits == (3 if claim.key in FINER else DIGITS[claim.unit]), claim.key


SCALES = {"%": 100.0, "mm": 1e3, "mm/s": 1e3, "N": 1.0, "s": 1.0, "": 1.0}


def test_what_is_measured_in_si_is_judged_in_the_unit_that_is_printed():
    for claim in (*BY_KEY.values(), *(claim for claims in FIG5.values() for claim in claims)):
        assert claim.scale == SCALES[claim.unit], claim.key


def test_a_force_off_proportion_by_an_exponent_is_as_far_off_as_the_exponent_says():
    p = runs(p={"bend": 0.1})
    # 4 x (1 - x)/10 is largest in the middle; the line begins a sample before the first reading, 1/260 of the way
    assert judge_claim(BY_KEY["scale_linear"], p).value == pytest.approx(10.0, abs=0.5)


def test_where_the_height_is_no_constant_nothing_shows_that_the_force_is_one():
    assert "force_unchanged" not in fig4_score(runs(p={"z_wobble": 0.19e-3})).failed_keys
    assert fig4_score(runs(p={"z_wobble": 0.21e-3})).failed_keys == ["force_unchanged"]


@pytest.mark.parametrize("trigger", [0.0, 0.1, np.inf])
def test_a_force_loop_that_is_on_at_once_or_never_fails_what_the_trigger_does(trigger: float):
    run = runs(fp={"trigger": trigger}) if trigger < 1.0 else runs()
    if trigger > 1.0:
        run.force_position.recording["controller.triggered"][:] = False
    assert {"trigger_time", "position_jumps"} <= set(fig4_score(run).failed_keys)


@pytest.mark.parametrize(("trigger", "faster"), [(5.6, 1.0), (0.1, np.nan), (T[-1] - 0.1, np.nan)])
def test_how_much_faster_it_gets_takes_a_glimpse_before_and_one_after_the_trigger(trigger: float, faster: float):
    # beyond its ends interpolation would take the run to stand still
    down = runs(fp={"trigger": trigger})
    down.force_position.recording["estimator.p_B"][:, 2] = -0.001 * T
    assert position_jump(down) == pytest.approx(faster, nan_ok=True)


def test_without_imperfect_runs_nothing_is_said_of_x_and_which_are_missing_is():
    two = runs()
    score = fig4_score(type(two)(two.force_position, two.position))
    x = {f.claim.key: f for f in score.claims if f.verdict == "trivial"}
    assert set(x) == {"x_small", "friction_smaller_x"}
    assert all("fig4_imperfect_position.toml" in f.reason and not f.measured_text for f in x.values())


def test_imperfect_runs_without_a_force_in_x_say_nothing():
    symmetrical = runs(x_fp={"friction": (0.0, -1.1)}, x_p={"friction": (0.0, -1.0)})
    assert symmetrical.without_x == "the true F_x is 0 by symmetry"


def test_every_claim_quotes_the_paper_or_says_that_it_is_ours_and_gives_the_reason_of_its_bound():
    for claim in BY_KEY.values():
        assert claim.quote and (claim.measure is None or "ours: " in claim.source or "printed" in claim.source)
