"""The bodies beside what is printed of people.

What stands here was read: a table, a page or a file of data as a whole. Of some sources no more than the abstract could
be read; they are named, and nothing in them is a yardstick.
"""

from collections.abc import Mapping
from functools import partial

from validation.yardstick import NotHere, Yardstick

RADII = {"calf": (52.2, 70.5), "thigh": (83.9, 115.1), "forearm": (37.4, 55.4), "upper_arm": (41.2, 66.5)}
"""mm. ANSUR II, files of 1,986 women and 4,082 men, columns calfcircumference, thighcircumference,
forearmcircumferenceflexed and bicepscircumferenceflexed (mm) over 2 pi: from the 5th percentile of the women to the
95th of the men. Forearm and upper arm are flexed there, which makes them thicker than at rest."""
BELLY = (169.7, 266.6)
"""mm. The same files, waistbreadth b and waistdepth d: b^2/(2 d), the radius at the front of an ellipse of that size,
which is our reading; from the 5th percentile of the women to the 95th of the men."""
RATE = (12.0, 18.0)
"""1/min. MedlinePlus, Vital signs, reviewed 2023: "Breathing: 12 to 18 breaths per minute"."""
LIFT = (6.9, 19.0)
"""mm. Krilavicius et al. 2013, recordings of normal breathing ("-N-"), people "lying face up": how far the height of a
marker at the centre of the upper and of the lower abdomen (UAC, LAC) goes from breath to breath. Medians of the breaths
of each recording, of which the smallest is 6.9 (UAC) and the largest 19.0 (LAC), behind a band-pass from 0.05 to 1 Hz;
the height is the coordinate z, in which these markers move most."""
ISO = {"back": 35.0, "shoulder": 35.0, "belly": 10.0, "upper_arm": 30.0, "forearm": 40.0, "thigh": 50.0, "calf": 60.0}
"""N/mm. "Based on ISO/TS 15066 for 75 kg", eff_spring_const_human in src/collision.py of LASA's human-robot-collider:
chest (back) 35, belly 10, upper arms 30, forearms 40, upper legs 50, shins 60. A page of another maker has 35 for back
and shoulders and 10 for the belly, too. The specification itself was not read."""
SPINE = 4.8
"""N/mm, mean of 80 patients, standard deviation 1.8. doi 10.1186/s12906-017-1821-1 (2017), Table 2, baseline: "Lumbar
spine stiffness, Palpatory GS (N/mm) at L3 80 4.8 1.8"; by two other devices 7.7 (2.1) and 5.2 (1.5)."""
ARM = (76.0, 130.0)
"""kPa, one standard deviation below the mean of the women, and that mean. A table of BMJ Military Health (Table 1,
demographic data and pain pressure thresholds): "PPT arm (kPa) 171 (+-67) 204 (+-65) 130 (+-54)": all, men, women."""


def outside(value: float, low: float, high: float) -> float:
    """How far a value is from a range; 0 in it."""
    return max(low - value, value - high, 0.0)


def radii() -> Mapping[str, float]:
    from validation.people import body

    return {name: outside(1e3 * (body(name)[0].radius or 0.0), *where) for name, where in RADII.items()}


def belly_radius() -> Mapping[str, float]:
    from validation.people import body

    return {"belly": outside(1e3 * (body("belly")[0].radius or 0.0), *BELLY)}


def breaths() -> Mapping[str, float]:
    from validation.people import REGIONS, body

    breathing = {name: body(name)[0].breathing for name in REGIONS}
    return {name: outside(60.0 * b.rate, *RATE) for name, b in breathing.items() if b is not None}


def lift() -> Mapping[str, float]:
    from validation.people import body

    breathing = body("belly")[0].breathing
    return {"belly": outside(2e3 * breathing.amplitude if breathing else 0.0, *LIFT)}


def stiffer_than_in_a_collision() -> Mapping[str, float]:
    from validation.people import stiffness_at

    return {name: outside(1e-3 * stiffness_at(name, 15.0), 0.0, bound) for name, bound in ISO.items()}


def stiffer_than_the_spine() -> Mapping[str, float]:
    from validation.people import stiffness_at

    return {name: outside(1e-3 * stiffness_at(name, 5.0), 0.0, SPINE) for name in ("back", "shoulder")}


def pressure_on_the_arm() -> Mapping[str, float]:
    from twin.robot.monitor.limits import Monitor
    from validation.people import pressure

    return {"at the monitor's limit": outside(1e-3 * pressure(Monitor().force_limit), 0.0, ARM[0])}


def not_here(why: str) -> Mapping[str, float]:
    raise NotHere(why)


ABSTRACT = "it could be read as an abstract only, and no number is taken from it"
CLOSED = "it is sold, public reproductions of its forces contradict one another, and no number is taken from them"
UNREAD = "nothing was compared"


def unread(claim: str, source: str, unit: str, why: str = ABSTRACT) -> Yardstick:
    """A row for a source that could not be read."""
    return Yardstick(claim, source, unit, 0.0, UNREAD, partial(not_here, why))


INSIDE = "it is inside of the range or is not"
YARDSTICKS = (
    Yardstick(
        "radii of calf, thigh, forearm, upper arm: circumferences from the 5th percentile of women to the 95th of men",
        "ANSUR II, 2012, 6,068 people, United States Army",
        "mm",
        0.0,
        INSIDE,
        radii,
    ),
    Yardstick(
        "radius of the belly: front of an ellipse as broad and deep as waists are",
        "ANSUR II, 2012, 6,068 people, United States Army",
        "mm",
        0.0,
        INSIDE,
        belly_radius,
    ),
    Yardstick(
        "breaths per minute of back and belly: 12 to 18",
        "MedlinePlus, Vital signs, National Library of Medicine, 2023",
        "per minute",
        0.0,
        INSIDE,
        breaths,
    ),
    Yardstick(
        "OUTSIDE: a breath lifts the belly by 4 mm, those of people lying face up by 6.9 to 19.0 mm",
        "recordings of Krilavicius et al., Baltic Institute of Advanced Technologies, 2013, published by Pohl",
        "mm",
        2.95,
        "known and not mended: the belly of the other pages was run with 4 mm, see docs/bodies.md; the bound "
        "says that it is no farther out",
        lift,
    ),
    Yardstick(
        "each region at 15 N is no stiffer than the spring that stands for it in a collision",
        "ISO/TS 15066:2016, Annex A, as a program of EPFL reproduces it",
        "N/mm",
        0.0,
        "a bound: it belongs to large areas and harder blows",
        stiffer_than_in_a_collision,
    ),
    Yardstick(
        "back and shoulder at 5 N are no stiffer than the lumbar spine that is pressed on itself, 4.8 N/mm",
        "doi 10.1186/s12906-017-1821-1, Table 2, 80 patients, 2017",
        "N/mm",
        0.0,
        "a bound: bone gives less than what lies beside it",
        stiffer_than_the_spine,
    ),
    Yardstick(
        "15 N under all of the head, 48 kPa, are less than what begins to hurt on an arm, 130 less 54 kPa",
        "BMJ Military Health, table of pain pressure thresholds, women",
        "kPa",
        0.0,
        "inside of it, as long as the head lies flat: an edge presses harder",
        pressure_on_the_arm,
    ),
    unread("force over depth of the belly, relaxed and not", "Remus et al., Front Bioeng Biotechnol, 2024", "N"),
    unread("modulus of limbs under a probe", "Zheng and Mak, J Biomech Eng 121:330, 1999", "kPa"),
    unread("modulus of skin, fat and muscle under 1 to 30 N", "Isogai et al., J Phys Ther Sci 34:777, 2022", "kPa"),
    unread("friction of dry skin", "Zhang and Mak, Prosthet Orthot Int 23:135, 1999", "of 1"),
    unread("friction of skin with wax and oil", "Yap et al., Sci Rep, 2021", "of 1"),
    unread("how far the back moves in breathing", "De Groote et al., J Appl Physiol 83:1531, 1997", "mm"),
    unread("limits of force and pressure by region", "ISO/TS 15066:2016, Annex A, Table A.2", "N", CLOSED),
    unread("pain thresholds of 29 places, force and pressure", "Han et al., Sensors 22:2996, 2022", "N"),
    unread("pain thresholds of 28 places, force and pressure", "Behrens et al., Front Robot AI 8:667818, 2022", "N"),
)
