"""[contact]: what the robot presses on. Keys carry units, attributes are SI (see `quantity.py`)."""

from typing import Any, Literal, NamedTuple

from pydantic import Field, ValidationInfo, field_validator

from twin.experiment.quantity import Section, quantity


class LawKeys(NamedTuple):
    """The keys that a law knows besides the stiffness."""

    needed: tuple[str, ...]
    optional: tuple[str, ...] = ()

    @property
    def all(self) -> tuple[str, ...]:
        return self.needed + self.optional


Law = Literal["hunt_crossley", "kelvin_voigt", "exponential"]
LAWS: dict[Law, LawKeys] = {
    "hunt_crossley": LawKeys(("damping",), ("exponent", "reference_depth")),
    "kelvin_voigt": LawKeys(("damper", "touch_depth")),
    "exponential": LawKeys(("damping", "stiffening")),
}


class Breathing(Section):
    """[contact.breathing]: the surface goes up by twice the amplitude and back with every breath."""

    amplitude: float = quantity("amplitude_mm", "half the way from breath to breath", ge=0, examples=[1.0])
    rate: float = quantity("rate_per_min", "breaths per time", gt=0, examples=[15.0])
    start: float = quantity("start_s", "first breath", 0.0, ge=0)
    end: float | None = quantity("end_s", "last breath", None, ge=0, examples=[20.0])


class Shift(Section):
    """[contact.shift]: the person moves once; if an end is given, back again from then on."""

    by: tuple[float, float, float] = quantity("by_mm", "how far (x, y, z)", examples=[[0.0, 0.0, 2.0]])
    start: float = quantity("start_s", "when it moves", ge=0, examples=[5.0])
    rise: float = quantity("rise_s", "how long it takes", gt=0, examples=[0.5])
    end: float | None = quantity("end_s", "when it moves back", None, ge=0, examples=[20.0])


class Contact(Section):
    """[contact]: a surface, how it answers to being pressed in and rubbed, and how it moves.

    Which law the stiffness and the keys of `LAWS` belong to: see `twin/plant/contact_law.py`.

    Attributes:
        body: the file in bodies/ that filled this table in.
        kind: for people; a law or shape is not tied to it.
    """

    body: str | None = Field(
        None, examples=["back"], description="a file of bodies/ that fills in what this table does not say"
    )
    kind: Literal["scale", "skin"] = Field(description="for people")
    height: float = quantity("height_mm", "z of the surface's highest point, or of the plane at x = y = 0")
    tilt: float = quantity("tilt_deg", "tilt about y", gt=-45, lt=45)
    tilt_x: float = quantity("tilt_x_deg", "tilt about x", 0.0, gt=-45, lt=45)
    radius: float | None = quantity("radius_mm", "radius of a sphere or cylinder", None, gt=0, examples=[60.0])
    shape: Literal["plane", "sphere", "cylinder_x", "cylinder_y"] = Field("plane", description="shape of the surface")
    stiffness: float = quantity("stiffness_N_per_m", "stiffness; the laws say at which depth", ge=0)
    damping: float | None = quantity(
        "damping_s_per_m",
        "Hunt-Crossley and exponential: force grows by this share per speed of pressing in",
        None,
        ge=0,
        examples=[3.0],
    )
    exponent: float | None = Field(None, ge=1, le=5, examples=[1.5], description="Hunt-Crossley: force over depth")
    reference_depth: float | None = quantity(
        "reference_depth_mm",
        "Hunt-Crossley with an exponent: depth at which the stiffness holds",
        None,
        gt=0,
        examples=[4.0],
    )
    damper: float | None = quantity("damper_N_s_per_m", "Kelvin-Voigt: viscous damper", None, ge=0, examples=[10.0])
    touch_depth: float | None = quantity(
        "touch_depth_mm", "Kelvin-Voigt: depth over which damper and spring take hold", None, gt=0, examples=[1.0]
    )
    stiffening: float | None = quantity(
        "stiffening_per_mm", "exponential: relative growth of the stiffness per depth", None, gt=0, examples=[0.2]
    )
    # law and shape stand after the keys they decide on: a field's check sees the fields before it
    law: Law = Field("hunt_crossley", description="law of the normal force")
    friction: float = Field(ge=0, description="Coulomb coefficient")
    bristle: float = quantity("bristle_N_per_m", "lateral stiffness while sticking", gt=0)
    bristle_damping: float = quantity("bristle_damping_N_s_per_m", "lateral damping while sticking", ge=0)
    breathing: Breathing | None = None
    shift: Shift | None = None

    @property
    def law_constants(self) -> dict[str, Any]:
        """What is said of the law, by attribute."""
        return {name: getattr(self, name) for name in LAWS[self.law].all if getattr(self, name) is not None}

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
        missing = [name for name in LAWS[law].needed if _is_missing(name, info.data)]
        curved = law == "hunt_crossley" and (info.data.get("exponent") or 1.0) != 1.0
        if curved and _is_missing("reference_depth", info.data):
            missing.append("reference_depth")
        if missing:
            raise ValueError(f"needs {', '.join(_key(name) for name in missing)}")
        others = {name for keys in LAWS.values() for name in keys.all} - set(LAWS[law].all)
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
    """Whether nothing was said of `name`; a value that was refused is told as a mistake of its own."""
    return name in checked and checked[name] is None


def _key(name: str) -> str:
    return Contact.model_fields[name].alias or name
