"""[plant] and [contact] as the constants of plant and encoders; [contact] and [[fault]] as how the surface moves."""

import math
from collections.abc import Sequence

from twin.experiment.contact import Breathing, Contact, Shift
from twin.experiment.fault import NEVER, Fault
from twin.experiment.robot import Plant
from twin.plant.body import Motion, MotionKind
from twin.plant.contact_law import ContactLaw
from twin.plant.encoder import Shaft
from twin.plant.parameters import PlantParameters
from twin.plant.surface import Shape

SUDDEN = 0.02
"""Time (s) in which a surface jumps or drops away as a fault."""
BREATHING_RATE = 0.25
"""Of breathing as a fault (Hz): 15 per minute."""


def plant_parameters(plant: Plant, contact: Contact) -> PlantParameters:
    """What is true, SI."""
    p, c = plant, contact
    return PlantParameters(
        a=p.a, b=p.b, l_a=p.l_a, l_b=p.l_b, m_a=p.m_a, m_b=p.m_b, m_p=p.m_p, I_r=p.I_r, b_j=p.b_j,
        k_s=p.k_s, N=p.N, eta=p.eta, backlash=p.backlash, eta_rate=p.eta_rate,
        z_s=c.height, tilt=c.tilt, tilt_x=c.tilt_x,
        shape=int(Shape[c.shape.upper()]), radius=math.inf if c.radius is None else c.radius,
        law=int(ContactLaw[c.law.upper()]), K=c.stiffness, **{"damping": 0.0, **c.law_constants},
        mu=c.friction, sigma_0=c.bristle, sigma_1=c.bristle_damping,
        belt_compliance=p.belt_compliance, joint_friction=p.joint_friction, joint_presliding=p.joint_presliding,
        spring_hysteresis=p.spring_hysteresis, spring_stop=math.inf if p.spring_stop is None else p.spring_stop,
        joint_lower=-math.inf if p.joint_lower is None else p.joint_lower,
        joint_upper=math.inf if p.joint_upper is None else p.joint_upper, stop=p.stop,
        mounting_tilt=p.mounting_tilt, mounting_tilt_x=p.mounting_tilt_x, head=p.head,
    )  # fmt: skip


def shafts(plant: Plant) -> tuple[Shaft, Shaft]:
    """The encoders of the motors and of the joints."""
    p = plant
    return (
        Shaft(p.motor_counts_per_turn, p.motor_zero, p.motor_noise, p.motor_eccentricity, p.motor_eccentric_at),
        Shaft(p.joint_counts_per_turn, p.joint_zero, p.joint_noise, p.joint_eccentricity, p.joint_eccentric_at),
    )


def surface_motions(contact: Contact) -> tuple[Motion, ...]:
    """How the surface moves; empty: it does not."""
    return tuple(_motion(table) for table in (contact.breathing, contact.shift) if table is not None)


def fault_motions(faults: Sequence[Fault], tick: float) -> tuple[Motion, ...]:
    """How it moves because of those of `faults` that break the body; `tick` in s."""
    return tuple(motion for fault in faults if (motion := _broken(fault, tick)) is not None)


def _motion(table: Breathing | Shift) -> Motion:
    end = math.inf if table.end is None else table.end
    if isinstance(table, Breathing):
        return Motion(MotionKind.BREATHING, (0.0, 0.0, table.amplitude), table.start, end, rate=table.rate)
    return Motion(MotionKind.SHIFT, table.by, table.start, end, rise=table.rise)


def _broken(fault: Fault, tick: float) -> Motion | None:
    onset, end = fault.onset * tick, math.inf if fault.end == NEVER else fault.end * tick
    up, down = (0.0, 0.0, fault.magnitude), (0.0, 0.0, -fault.magnitude)
    match fault.kind:
        case "surface_jump":
            return Motion(MotionKind.SHIFT, up, onset, end, rise=SUDDEN)
        case "contact_loss":
            return Motion(MotionKind.SHIFT, down, onset, end, rise=SUDDEN)
        case "breathing":
            return Motion(MotionKind.BREATHING, up, onset, end, rate=BREATHING_RATE)
    return None
