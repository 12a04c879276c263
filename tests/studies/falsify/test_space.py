"""What is searched, and the experiment files that it becomes."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.laws.runs import EXPERIMENTS
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.fault import FAULT_KINDS
from twin.studies.falsify.judge import judge_run
from twin.studies.falsify.space import Space, TriedFault
from twin.studies.faults.magnitudes import UPPER_ENDS
from twin.studies.faults.offsets import on_disc

PRESSING = EXPERIMENTS / "pressing.toml"
TICK = 0.001


def space(base: Mapping[str, Any] | None = None, seed: int = 0) -> Space:
    quiet = [("quiet", "always (|plant.F_ee_B| <= 18 N)")]
    return Space(base or {}, quiet, tuple(FAULT_KINDS), 13_000, TICK, None, (None,), seed)


def written(folder: Path, where: Space, wrong: TriedFault) -> Path:
    file = folder / f"{wrong.kind}_{wrong.target}_{wrong.magnitude}_{wrong.seed}.toml"
    file.write_text(where.file(wrong, PRESSING))
    return file


def test_what_is_drawn_as_seed_is_added_to_that_of_the_noise_and_is_that_of_the_fault(tmp_path: Path):
    for seed in (0, 3):
        loaded = load_experiment(
            written(tmp_path, space(seed=7), TriedFault("sample_loss", "encoder", 0.02, seed=seed)), ()
        )
        assert (loaded.seed, loaded.faults[0].seed) == (7 + seed if seed else 0, seed)


def test_another_seed_is_another_run_of_a_noisy_robot_and_the_same_one_the_same(tmp_path: Path):
    noisy = {"plant": {"joint_noise_deg": 0.02}}
    files = [written(tmp_path, space(noisy), TriedFault("breathing", "contact", 1.0, 2000, seed=s)) for s in (1, 2)]
    one, other, again = (
        judge_run(PRESSING, None, [str(file)])["metrics"]["quiet.distance"] for file in (*files, files[0])
    )
    assert one == again != other


def test_each_kind_at_its_largest_is_an_experiment_that_can_be_run_with_either_sign(tmp_path: Path):
    where = space()
    for kind in where.kinds:
        for place in where.places(kind)[-2:]:
            wrong = TriedFault(kind, place.target, where.magnitude(kind, float(place.ways[0])), 500, place.body)
            assert where.place(wrong) == place
            with assemble(load_experiment(written(tmp_path, where, wrong), ())):
                pass


@given(st.sampled_from([kind for kind in FAULT_KINDS if FAULT_KINDS[kind].magnitudes]), st.floats(-2.0, 2.0))
def test_a_magnitude_and_its_share_say_the_same(kind: str, share: float):
    where = space()
    if len({place.ways for place in where.places(kind)}) == 1:
        share = abs(share)
    if UPPER_ENDS[kind].magnitude == (FAULT_KINDS[kind].magnitudes or (None,))[-1]:
        share = min(1.0, max(-1.0, share))
    magnitude = where.magnitude(kind, share)
    assert magnitude is not None
    # four digits, over a range of 1.4 at least: belief_eta and encoder_bias; of delays whole ticks of at least 2
    (again,) = where.shares(TriedFault(kind, "", magnitude))
    assert again == pytest.approx(share, abs=0.2 if FAULT_KINDS[kind].unit == "ms" else 2e-3)
    if FAULT_KINDS[kind].unit == "ms":
        assert magnitude == pytest.approx(round(magnitude), abs=1e-9)


def test_the_other_way_is_the_other_sign_or_the_inverse_of_a_factor():
    where = space()
    assert where.magnitude("encoder_bias", -1.0) == -2.0
    assert where.magnitude("belt_slip", -1.0) == 30.0
    assert where.magnitude("belief_k_s", -1.0) == 0.6667
    assert {place.ways for place in where.places("joint_friction")} == {(1,)}


@given(st.floats(0.0, 1.0), st.floats(0.0, 0.999))
def test_a_place_of_the_disc_is_as_far_out_as_its_share_of_the_area(outward: float, around: float):
    where = replace(space(), reach=0.03)
    x, y = on_disc(where.reach, outward, around)
    # a tenth of a millimetre
    assert math.hypot(x, y) ** 2 == pytest.approx(outward * where.reach**2, abs=2 * 1e-4 * where.reach)
    assert on_disc(where.reach, *where.polar((x, y))) == pytest.approx((x, y), abs=1.5e-4)


def test_an_offset_moves_every_task_and_the_signs_of_a_set_are_those_of_its_faults(tmp_path: Path):
    tasks = load_experiment(EXPERIMENTS / "massage.toml").tasks
    where = replace(space(), tasks=tasks, reach=0.01)
    wrong = where.fault(
        "encoder_drift+belt_slip", ("joint_encoder_2+joint_1", None), (-1.0, 0.5), 500, 0, (0.003, -0.001)
    )
    file = tmp_path / "moved.toml"
    file.write_text(where.file(wrong, EXPERIMENTS / "massage.toml"))
    loaded = load_experiment(file, ())
    for new, old in zip(loaded.tasks, tasks, strict=True):
        ends = [(getattr(new, key), getattr(old, key)) for key in ("point", "to") if hasattr(old, key)]
        assert all(end == pytest.approx((was[0] + 0.003, was[1] - 0.001)) for end, was in ends)
    drift, slip = loaded.faults
    # half the way from -2 to -30 deg, by ratio
    assert (drift.target, drift.magnitude) == ("joint_encoder_2", pytest.approx(math.radians(-2.0)))
    assert slip.magnitude == pytest.approx(-math.radians(math.sqrt(2.0 * 30.0)), rel=1e-3)
    assert where.place(wrong).ways == (-1, 1)
