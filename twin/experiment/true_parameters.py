"""[plant] and [contact] as the constants of the plant."""

import math

from twin.experiment.contact import Contact
from twin.experiment.schema import Plant
from twin.plant.contact_law import Law
from twin.plant.parameters import PlantParameters
from twin.plant.surface import Shape


def plant_parameters(plant: Plant, contact: Contact) -> PlantParameters:
    """What is true, SI."""
    p, c = plant, contact
    return PlantParameters(
        a=p.a, b=p.b, l_a=p.l_a, l_b=p.l_b, m_a=p.m_a, m_b=p.m_b, m_p=p.m_p, I_r=p.I_r, b_j=p.b_j,
        k_s=p.k_s, N=p.N, eta=p.eta, backlash=p.backlash, eta_rate=p.eta_rate,
        z_s=c.height, tilt=c.tilt, tilt_x=c.tilt_x,
        shape=int(Shape[c.shape.upper()]), radius=math.inf if c.radius is None else c.radius,
        law=int(Law[c.law.upper()]), K=c.stiffness, **{"damping": 0.0, **c.law_constants},
        mu=c.friction, sigma_0=c.bristle, sigma_1=c.bristle_damping,
    )  # fmt: skip
