"""What of tissue, schedule, breath and taps that learn does not fit together is refused before a run."""

import numpy as np
import pytest

from twin.kernel.errors import InputRefused
from twin.robot.assembly.checks.adaptive_loop import believed_loop, spectral_radius
from twin.robot.assembly.load import load_experiment
from twin.studies.tune.prediction import LawGains, corners, predict

TISSUE = "controller.tissue.dither_N=0.1"


def schedule(*points):
    entries = ("{{stiffness_N_per_m={},kp_mm_per_N={},ki_mm_per_N_s={}}}".format(*point) for point in points)
    return f"controller.force.schedule=[{','.join(entries)}]"


TWO = schedule((300, 2, 40), (700, 2, 30))


def pressing(*settings):
    return load_experiment("experiments/pressing.toml", settings)


@pytest.mark.parametrize(("settings", "said"), [
    ([TWO], "[controller.force] schedule needs [controller.tissue]"),
    (["controller.breath.rate_per_min=12"], "[controller.breath] needs [controller.tissue]"),
    (["controller.touch.force_learning=0.4"], "force_learning needs [controller.tissue]"),
    (["controller.tissue.frequency_Hz=40"], "the controller is called every 2 ms; expected at most 25"),
    ([schedule((300, 2, 40))], "[controller.force] schedule: one point; expected two or more"),
    ([schedule((300, 2, 40), (200, 2, 40))], "point 2 is at 200 N/m, after 300; expected the softest first"),
    ([schedule((300, 2, 40), (2000, 2, 40))], "a gap from 300 to 2000 N/m"),
    ([TISSUE, schedule((300, 2, 40), (700, 20, 40))], "point 2: kp = 20 mm/N and ki = 40 mm/(N s) shake on 700 N/m"),
    ([TISSUE, schedule((300, 2, 500), (700, 2, 30))], "point 1: kp = 2 mm/N and ki = 500 mm/(N s) shake"),
    ([TISSUE, TWO, 'change=[{t_s=5.0,key="controller.force.kp_mm_per_N",value=2.0}]'], "does not act in this"),
    (["controller.force.schedule=[{stiffness_N_per_m=300,kp_mm_per_N=2}]"],
     "[controller.force.schedule 1] missing key 'ki_mm_per_N_s'"),
])  # fmt: skip
def test_what_does_not_fit_together_is_told_in_a_sentence(settings, said):
    with pytest.raises(InputRefused) as refusal:
        pressing(*settings)
    assert said in str(refusal.value)


def test_a_robot_that_never_presses_by_force_learns_nothing_of_the_tissue():
    with pytest.raises(InputRefused, match=r"never presses by force"):
        load_experiment("experiments/fig4_position.toml", [TISSUE])


def test_what_fits_is_taken_and_off_by_default():
    experiment = pressing(TISSUE, TWO, "controller.breath.rate_per_min=12", "controller.touch.force_learning=0.4")
    assert [point.stiffness for point in experiment.controller.force.schedule] == [300.0, 700.0]
    plain = pressing()
    assert plain.controller.tissue is plain.controller.breath is None and plain.controller.force.schedule == ()


@pytest.mark.parametrize("K", [300.0, 1225.0, 5000.0])
def test_the_check_knows_about_the_gains_at_which_the_linear_model_of_the_analysis_shakes(K):
    """One mass and a drive of first order stand for three legs and the drive's FMU: no closer than a factor of 1.5."""
    alone = [f"contact.stiffness_N_per_m={K}", "contact.damping_s_per_m=0", "monitor.enabled=false"]
    experiment = load_experiment("experiments/pressing.toml", alone)
    loop = believed_loop(
        load_experiment("experiments/pressing.toml", [TISSUE]).controller, experiment.plant, experiment.start
    )
    corner = next(corner for corner in corners([experiment], None)[0] if corner.point.force_on)
    gains = np.geomspace(0.2e-3, 50e-3, 60)
    mine = next(kp for kp in gains if spectral_radius(loop, K, kp, 10.0 * kp) >= 1.0)
    theirs = next(kp for kp in gains if not predict(corner, LawGains(12.0, kp, 10.0 * kp)).stable)
    assert 1 / 1.5 < mine / theirs < 1.5
