"""Settings: the keys of a TOML table, each declared once, next to the law that uses it.

    class Damping(Settings):
        gain: float = setting("rad/s/(N m)", ge=0, help="motor speed per torque of the spring")

declares the key of the TOML file, `gain_rad_per_s_per_Nm`, its bounds and its meaning; `damping.gain` is the value in
SI. `Values` are the numbers of one or several tables for compiled code: the fields of a record.
"""

import math
from collections.abc import Iterable, Mapping
from functools import cache
from operator import itemgetter
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Self, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from twin.kernel.units import Unit, known_unit

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)
Triple = tuple[float, float, float]


class Setting(NamedTuple):
    """Declaration of one key of an experiment's table: unit, default, meaning and bounds.

    Attributes:
        unit: unit of the number in the file, `N m/rad`; "" without one.
        help: meaning, one phrase.
        more: bounds and examples, as keyword arguments of pydantic.
        default: default value in that unit; ... if the file must set it.
        field: field name in a record of compiled code.
        into: name of the compiled record that holds it; "" if the owner has one record, None if it is not compiled.
        absent: SI value in the record if the file's value is None.
        tunable: whether it may change while the robot runs.
        exported: whether it remains a parameter of an exported FMU.
        broken_by: kinds of faults that change it.
    """

    unit: str
    help: str
    more: Mapping[str, Any]
    default: Any = ...
    field: str = ""
    into: str | None = ""
    absent: Any = None
    tunable: bool = False
    exported: bool = True
    broken_by: tuple[str, ...] = ()

    def key(self, name: str) -> str:
        """Key of the setting in the file: `name` and the unit, joined by "_": `kp_mm_per_N`; words after "per" divide.

        A unit "factor" or "share" marks a pure number.
        """
        unit = self.unit.replace("N m", "Nm").translate({ord("("): None, ord(")"): None, ord(" "): "_"})
        return f"{name}_{unit.replace('1/', 'per_').replace('/', '_per_')}" if unit else name


def setting(unit: str = "", *, help: str, **declared: Any) -> Any:
    """Declare a key of an experiment's table by fields of `Setting` and, for its `more`, arguments of pydantic.

    `field` defaults to the key's own name.
    """
    own = {name: declared.pop(name) for name in Setting._fields if name in declared}
    return Setting(unit, help, declared, **own)


def optional(unit: str = "", *, help: str, example: Any, **declared: Any) -> Any:
    """Declare an optional key of an experiment's table, None by default, with an `example` value; see `setting`."""
    return setting(unit, help=help, default=None, examples=[example], **declared)


class _SettingsMeta(ModelMetaclass):
    """Metaclass that turns the declared settings of a class into fields of pydantic."""

    def __new__(mcs, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **more: Any) -> Any:
        own = {key: value for key, value in namespace.items() if isinstance(value, Setting)}
        for key, value in own.items():
            schema = {**value.more, "description": value.help} | ({"alias": value.key(key)} if value.unit else {})
            namespace[key] = Field(value.default, **schema)
        made: Any = super().__new__(mcs, name, bases, namespace, **more)
        inherited = {key: value for base in reversed(bases) for key, value in getattr(base, "settings", {}).items()}
        made.settings = inherited | {key: value._replace(field=value.field or key) for key, value in own.items()}
        return made


class Settings(BaseModel, metaclass=_SettingsMeta):
    """A table of the experiment file, checked: unknown keys are refused, numbers finite, types not converted."""

    settings: ClassVar[dict[str, Setting]]

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=True)

    @field_validator("*", mode="after")
    @classmethod
    def _to_si(cls, value: Any, info: ValidationInfo) -> Any:
        is_quantity, unit = _unit_of(cls, info.field_name or "")
        if not is_quantity or value is None:
            return value
        # a `share` and a `factor` have no unit
        si = value if unit is None else unit.in_si(value)
        if not _is_finite(si):
            raise ValueError("expected a number that is finite in SI units, too")
        return si


@cache
def _unit_of(table: type[Settings], name: str) -> tuple[bool, Unit | None]:
    """Return (whether the key of the setting `name` has a unit, that unit; None for a pure number)."""
    key = table.model_fields[name].alias
    return key is not None, None if key is None else known_unit(key.removeprefix(f"{name}_"))


def _is_finite(value: Any) -> bool:
    return all(map(_is_finite, value)) if isinstance(value, tuple) else math.isfinite(value)


class FieldSource(NamedTuple):
    """Source of a number in a record: SI value of the setting `name` of `table` / `divisor` * `times`.

    `broken_by` are the kinds of faults that change it in this record.
    """

    table: type[Settings]
    name: str
    times: float = 1.0
    divisor: float = 1.0
    broken_by: tuple[str, ...] = ()

    @property
    def setting(self) -> Setting:
        return self.table.settings[self.name]

    @property
    def form(self) -> str:
        """Type of the record field: `f8` a number, `3f8` three numbers, `i8` a choice."""
        kind = self.table.model_fields[self.name].annotation
        return "i8" if get_origin(kind) is Literal else "3f8" if get_origin(kind) is tuple else "f8"

    def number(self, table: Settings) -> Any:
        """Return the record's number for the experiment's `table`; a choice is its index from 0."""
        return self.record_value(getattr(table, self.name))

    def record_value(self, value: Any) -> Any:
        """Convert a setting's `value` (SI) to the number in the compiled record."""
        if value is None:
            return self.setting.absent
        if self.form == "i8":
            return get_args(self.table.model_fields[self.name].annotation).index(value)
        # skip the division if unscaled: the value stays the same to the last bit
        return value if self.times == self.divisor == 1.0 else value / self.divisor * self.times


def fields_of_form(form: str, names: str) -> dict[str, str]:
    """Declare fields of one type for a compiled record: `record(**fields_of_form("f8", "k c error"), known="i8")`."""
    return dict.fromkeys(names.split(), form)


Fields = Mapping[str, FieldSource | Setting]
"""Fields of a record by name: the source of each number, or the declaration of a number that no file sets."""


def setting_fields(table: type[Settings], *names: str, into: str = "") -> dict[str, FieldSource]:
    """Return the compiled record's fields for the settings `names` of `table`; by default all with `into`."""
    chosen = names or [name for name in table.settings if table.settings[name].into == into and _is_number(table, name)]
    return {table.settings[name].field: FieldSource(table, name) for name in chosen}


def numbers(table: Settings, into: str = "") -> dict[str, Any]:
    """Return the field values of a compiled record from the numbers of one table; `into` as in `setting_fields`."""
    return {field: source.number(table) for field, source in setting_fields(type(table), into=into).items()}


def _is_number(table: type[Settings], name: str) -> bool:
    """Whether compiled code has a type for the setting's values; false for text, booleans and tables."""
    kind = table.model_fields[name].annotation
    kinds = [part for part in (get_args(kind) or (kind,)) if part is not type(None)]
    return get_origin(kind) is Literal or all(part in (float, int) for part in kinds)


class Values(tuple[Any, ...]):
    """Base of records of numbers for compiled code, SI: a named tuple whose fields are declared by settings.

    A subclass lists its `parts`; `twin.kernel.cosim.port.record_of` makes a record of it. `sources` has the setting
    that decides a field, `forms` types `f8`, `3f8`, `i8`, `broken_by` the field that a kind of fault changes.
    """

    _fields: ClassVar[tuple[str, ...]]
    _field_defaults: ClassVar[dict[str, Any]]
    sources: ClassVar[dict[str, FieldSource]]
    forms: ClassVar[dict[str, str]]
    broken_by: ClassVar[dict[str, str]]

    def __init_subclass__(cls, parts: Iterable[Fields] = (), first: str = "") -> None:
        """Declare the fields of all `parts` as fields of the record, in order; fields named in `first` come first."""
        named = {name: field for part in parts for name, field in part.items()}
        fields = {name: named[name] for name in first.split()} | named
        cls._fields = tuple(fields)
        cls.sources = {name: field for name, field in fields.items() if isinstance(field, FieldSource)}
        cls.forms = {
            name: field.form if isinstance(field, FieldSource) else "3f8" if isinstance(field.default, tuple) else "f8"
            for name, field in fields.items()
        }
        kinds = {name: field.broken_by or getattr(field, "setting", field).broken_by for name, field in fields.items()}
        cls.broken_by = {kind: name for name in fields for kind in kinds[name]}
        cls._field_defaults = {name: start for name, field in fields.items() if (start := _start_of(field)) is not None}
        for index, name in enumerate(fields):
            setattr(cls, name, property(itemgetter(index)))

    def __new__(cls, *values: Any, **named: Any) -> Self:
        given = dict(zip(cls._fields, values, strict=False)) | named
        if unknown := [name for name in given if name not in cls._fields] + list(values[len(cls._fields) :]):
            raise TypeError(f"{cls.__name__}: no field for {unknown}")
        return tuple.__new__(cls, [given[name] if name in given else cls._field_defaults[name] for name in cls._fields])

    @classmethod
    def from_tables(cls, *tables: Settings, **more: Any) -> Self:
        """Build the compiled record from the values of experiment `tables`, with the fields in `more` overridden."""
        for name, source in cls.sources.items():
            if name not in more:
                more[name] = source.number(next(table for table in tables if isinstance(table, source.table)))
        return cls(**more)

    def _asdict(self) -> dict[str, Any]:
        return dict(zip(self._fields, self, strict=True))

    def _replace(self, **values: Any) -> Self:
        return type(self)(**(self._asdict() | values))

    def __getnewargs__(self) -> tuple[Any, ...]:
        return tuple(self)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in self._asdict().items())})"

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


def _start_of(field: FieldSource | Setting) -> Any:
    """Return the default value of a record's field, SI; None if a value is required."""
    declared = field.setting if isinstance(field, FieldSource) else field
    if declared.default is ...:
        return None
    if not isinstance(field, FieldSource):
        return declared.default
    _, unit = _unit_of(field.table, field.name)
    return field.record_value(
        declared.default if unit is None or declared.default is None else unit.in_si(declared.default)
    )
