"""Contact laws of [contact]: the normal force of a surface from depth d and rate d_dot.

    Hunt-Crossley  F = K d (d / d_ref)^(n - 1) (1 + c d_dot)             Hunt and Crossley (1975), J Appl Mech 42:440
    Kelvin-Voigt   F = K d + C w(d / d_touch) d_dot                      Fung (1993), Biomechanics, Ch. 2
    exponential    F = K / beta (exp(beta d) - 1) (1 + c d_dot)          Fung (1993), Ch. 7

F is clamped at 0: a surface does not pull. Each law is an elastic force with a potential, plus a term with the sign of
d_dot; clamping only removes energy that would be returned. So no closed cycle gains energy.

Hunt and Crossley's stiffness has the unit N/m^n; here K (N/m) is the secant stiffness at the reference depth d_ref,
F(d_ref) = K d_ref, so that n has no unit to carry. In the exponential law K is the stiffness at first touch.

Kelvin-Voigt's damper alone would jump to C d_dot at first touch. The fade w(s) = s^2 (3 - 2 s), 1 from s = 1 on, is
smooth: a contact that grows over the touch depth.
"""

import math
from enum import IntEnum
from typing import Any, Literal, NamedTuple

from pydantic import ValidationInfo, field_validator

from twin.kernel.compiled.function import njit
from twin.kernel.settings import Settings, optional, setting
from twin.robot.plant.surface_motion import Breathing, Shift


class ContactLaw(IntEnum):
    """Law of the contact's normal force; names as in an experiment's file, in capitals."""

    HUNT_CROSSLEY = 0
    KELVIN_VOIGT = 1
    EXPONENTIAL = 2


# NumPy division: a parameter that a fault has set to 0 must give NaN, because an exception is lost in compiled code
# that the master calls by address
@njit(cache=True, error_model="numpy", forceinline=True)
def elastic_force(parameters, d):
    """Return the static contact force (N) of the surface at depth `d` > 0 (m)."""
    if parameters.law == ContactLaw.EXPONENTIAL:
        return parameters.K / parameters.stiffening * math.expm1(parameters.stiffening * d)
    if parameters.law == ContactLaw.HUNT_CROSSLEY and parameters.exponent != 1.0:
        return parameters.K * d * (d / parameters.reference_depth) ** (parameters.exponent - 1.0)
    return parameters.K * d


@njit(cache=True, error_model="numpy", forceinline=True)
def pressing_force(parameters, d, rate):
    """Return the normal force (N, >= 0) of the contact law at depth `d` (m) and its rate of change (m/s)."""
    if d <= 0.0:
        return 0.0
    if parameters.law == ContactLaw.KELVIN_VOIGT:
        share = min(d / parameters.touch_depth, 1.0)
        fade = share * share * (3.0 - 2.0 * share)
        return max(elastic_force(parameters, d) + parameters.damper * fade * rate, 0.0)
    return max(elastic_force(parameters, d) * (1.0 + parameters.damping * rate), 0.0)


class LawKeys(NamedTuple):
    """Mandatory and optional keys of a contact law in [contact], apart from the stiffness."""

    needed: tuple[str, ...]
    optional: tuple[str, ...] = ()

    @property
    def all(self) -> tuple[str, ...]:
        return self.needed + self.optional


Law = Literal["hunt_crossley", "kelvin_voigt", "exponential"]
KEYS_BY_LAW: dict[Law, LawKeys] = {
    "hunt_crossley": LawKeys(("damping",), ("exponent", "reference_depth")),
    "kelvin_voigt": LawKeys(("damper", "touch_depth")),
    "exponential": LawKeys(("damping", "stiffening")),
}


class Contact(Settings):
    """[contact]: a surface, its reaction to pressing and rubbing, and its motion.

    Which law the stiffness and the keys of `KEYS_BY_LAW` belong to: see `twin/robot/plant/contact_law.py`.

    Attributes:
        body: the file in bodies/ that filled this table in.
        kind: for people; a law or shape is not tied to it.
    """

    body: str | None = optional(example="back", help="file of experiments/bodies/ with the defaults of the keys below")
    kind: Literal["scale", "skin"] = setting(into=None, help="kind of surface: its colour in pictures")
    height: float = setting("mm", field="z_s", help="z of the surface's highest point, or of the plane at x = y = 0")
    tilt: float = setting("deg", gt=-45, lt=45, help="tilt of the surface about y")
    tilt_x: float = setting("deg", default=0.0, gt=-45, lt=45, help="tilt about x, applied before the tilt about y")
    radius: float | None = optional("mm", absent=math.inf, gt=0, example=60.0, help="radius of a sphere or cylinder")
    shape: Literal["plane", "sphere", "cylinder_x", "cylinder_y"] = setting(
        default="plane", help="shape of the surface"
    )
    stiffness: float = setting("N/m", field="K", broken_by=("stiffness_change",), ge=0, help="K of the law")
    damping: float | None = optional(
        "s/m", absent=0.0, ge=0, example=3.0, help="c of hunt_crossley and exponential: force share per pressing speed"
    )
    exponent: float | None = optional(
        absent=1.0, ge=1, le=5, example=1.5, help="n of hunt_crossley, exponent of force over depth; without it, 1"
    )
    reference_depth: float | None = optional(
        "mm", absent=1e-3, gt=0, example=4.0, help="depth of the secant stiffness K, for hunt_crossley with n not 1"
    )
    damper: float | None = optional("N s/m", absent=0.0, ge=0, example=10.0, help="C of kelvin_voigt, a viscous damper")
    touch_depth: float | None = optional(
        "mm", absent=1e-3, gt=0, example=1.0, help="depth over which the damper of kelvin_voigt fades in"
    )
    stiffening: float | None = optional(
        "1/mm", absent=0.0, gt=0, example=0.2, help="beta of exponential, relative growth of the stiffness per depth"
    )
    # law and shape follow the keys that they depend on: a field's validator only sees the fields before it
    law: Law = setting(default="hunt_crossley", help="law of the normal force")
    friction: float = setting(field="mu", ge=0, help="coefficient of Coulomb friction mu")
    bristle: float = setting("N/m", field="sigma_0", gt=0, help="lateral stiffness while sticking, sigma_0")
    bristle_damping: float = setting("N s/m", field="sigma_1", ge=0, help="lateral damping while sticking, sigma_1")
    breathing: Breathing | None = None
    shift: Shift | None = None

    @property
    def motions(self) -> list[Breathing | Shift]:
        """Tables of the surface's motions, breathing and shift, that the experiment has."""
        return [table for table in (self.breathing, self.shift) if table is not None]

    @property
    def law_constants(self) -> dict[str, Any]:
        """Given constants of the contact law, by attribute."""
        return {name: getattr(self, name) for name in KEYS_BY_LAW[self.law].all if getattr(self, name) is not None}

    @field_validator("shape")
    @classmethod
    def _radius_where_it_belongs(cls, shape: str, info: ValidationInfo) -> str:
        flat, has_radius = shape == "plane", info.data.get("radius") is not None
        if flat and has_radius:
            raise ValueError("has no radius; remove radius_mm or name the shape it belongs to")
        if not flat and not has_radius and "radius" in info.data:
            raise ValueError("missing key 'radius_mm'")
        return shape

    @field_validator("stiffness")
    @classmethod
    def _skin_resists(cls, stiffness: float, info: ValidationInfo) -> float:
        if stiffness == 0.0 and info.data.get("kind") == "skin":
            raise ValueError("a skin that does not resist is not there; expected a number > 0")
        return stiffness

    @field_validator("law")
    @classmethod
    def _keys_of_one_law(cls, law: Law, info: ValidationInfo) -> Law:
        missing = [name for name in KEYS_BY_LAW[law].needed if _is_missing(name, info.data)]
        curved = law == "hunt_crossley" and (info.data.get("exponent") or 1.0) != 1.0
        if curved and _is_missing("reference_depth", info.data):
            missing.append("reference_depth")
        if missing:
            raise ValueError(f"needs {', '.join(_key(name) for name in missing)}")
        others = {name for keys in KEYS_BY_LAW.values() for name in keys.all} - set(KEYS_BY_LAW[law].all)
        foreign = sorted(_key(name) for name in others if info.data.get(name) is not None)
        if foreign:
            raise ValueError(f"does not know {', '.join(foreign)}; remove it or name the law it belongs to")
        return law

    @field_validator("breathing", "shift")
    @classmethod
    def _ends_after_it_starts(cls, table: Breathing | Shift | None) -> Breathing | Shift | None:
        if table is not None and table.end is not None and table.end <= table.start:
            raise ValueError(f"ends at {table.end:g} s, before it starts at {table.start:g} s")
        return table


def _is_missing(name: str, checked: dict[str, Any]) -> bool:
    """Whether a key of a table is missing; an invalid value has been reported already and does not count."""
    return name in checked and checked[name] is None


def _key(name: str) -> str:
    return Contact.model_fields[name].alias or name
