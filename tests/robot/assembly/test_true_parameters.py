"""Each number of a file becomes the constant of that name, in SI; what moves becomes motions of the surface."""

import numpy as np
import pytest

from tests.laws.runs import FORCE, shipped
from twin.robot.assembly.build import plant_parameters, surface_motions
from twin.robot.plant.dynamics import PlantParameters
from twin.robot.plant.surface_motion import MotionKind

FILE = {
    "plant.a_mm": 51.0, "plant.b_mm": 31.0, "plant.l_a_mm": 61.0, "plant.l_b_mm": 115.0,
    "plant.m_a_g": 41.0, "plant.m_b_g": 32.0, "plant.m_p_g": 103.0, "plant.I_r_kg_m2": 3e-5,
    "plant.b_j_Nm_s_per_rad": 4e-3, "plant.k_s_Nm_per_rad": 1.1, "plant.N": 2.5, "plant.eta": 0.9,
    "plant.backlash_deg": 0.2, "plant.eta_rate_rad_per_s": 0.3,
    "contact.height_mm": -102.0, "contact.tilt_deg": 1.0, "contact.stiffness_N_per_m": 1300.0,
    "contact.damping_s_per_m": 3.5, "contact.friction": 0.25, "contact.bristle_N_per_m": 4100.0,
    "contact.bristle_damping_N_s_per_m": 8.5,
}  # fmt: skip
SI = {
    "a": 0.051, "b": 0.031, "l_a": 0.061, "l_b": 0.115, "m_a": 0.041, "m_b": 0.032, "m_p": 0.103, "I_r": 3e-5,
    "b_j": 4e-3, "k_s": 1.1, "N": 2.5, "eta": 0.9, "backlash": 0.2 * np.pi / 180.0, "eta_rate": 0.3,
    "z_s": -0.102, "tilt": np.pi / 180.0, "K": 1300.0, "damping": 3.5, "mu": 0.25, "sigma_0": 4100.0, "sigma_1": 8.5,
    "tilt_x": 0.0, "shape": 0.0, "radius": np.inf, "law": 0.0,
}  # fmt: skip


def test_what_the_file_says_is_what_the_plant_is_made_of():
    experiment = shipped(FORCE, *(f"{key}={number}" for key, number in FILE.items()))
    found = plant_parameters(experiment.plant, experiment.contact)._asdict()
    # rounding of a unit's factor
    assert {name: found[name] for name in SI} == pytest.approx(SI, rel=1e-15)
    # a joint in the condition in which it was built, and the constants of other laws
    assert {name: value for name, value in found.items() if name not in SI} == {
        name: default for name, default in PlantParameters._field_defaults.items() if name not in SI
    }


def test_a_surface_at_rest_has_no_motions():
    assert surface_motions(shipped().contact) == ()


def test_breathing_and_a_shift_move_the_surface():
    breath, once = "{amplitude_mm=2.0, rate_per_min=15.0}", "{by_mm=[1, 0, -4], start_s=2, rise_s=0.5, end_s=6}"
    contact = shipped(FORCE, f"contact.breathing={breath}", f"contact.shift={once}").contact
    breathing, shift = surface_motions(contact)
    assert (breathing.kind, breathing.displacement, breathing.rate) == (MotionKind.BREATHING, (0.0, 0.0, 0.002), 0.25)
    assert (breathing.onset, breathing.end) == (0.0, np.inf)
    assert (shift.kind, shift.displacement, shift.rise) == (MotionKind.SHIFT, (0.001, 0.0, -0.004), 0.5)
    assert (shift.onset, shift.end) == (2.0, 6.0)
