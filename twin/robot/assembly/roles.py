"""Third-party parts of the robot: required ports per role, and their components.

FMUs and Python classes are used in the same way; downstream only the name shows that a part is not twin's own.
"""

import inspect
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import Port, port_slices
from twin.kernel.cosim.python_class import (
    DeclaredPorts,
    NamedPorts,
    PythonComponent,
    PythonSource,
    declared_ports,
    make_instance,
)
from twin.kernel.cosim.selection import Selection
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import FmuDescription, described
from twin.kernel.fmi.groups import announce_call
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.fmi.variable import Setting, Setup, Value, Variable, to_json
from twin.kernel.units import NUMBER, known_unit
from twin.robot.assembly.drives import is_system, refuse_other_file
from twin.robot.controller.controller import ESTIMATOR_INPUTS, ESTIMATOR_OUTPUTS, P_REF_B
from twin.robot.controller.task_controller import TASK_INPUTS, TASK_OUTPUTS
from twin.robot.drive.contract import Role
from twin.robot.drive.mapping import Binding, Wiring, fill_roles, split_unit, with_units
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.stand_in import StandIn
from twin.robot.monitor.component import MONITOR_INPUTS as MONITOR_INPUTS
from twin.robot.monitor.component import MONITOR_OUTPUTS as MONITOR_OUTPUTS
from twin.robot.plant.encoder import SCALE_INPUTS, SCALE_OUTPUTS
from twin.robot.plant.surface_motion import BODY_OUTPUTS as BODY_OUTPUTS

if TYPE_CHECKING:
    from twin.kernel.systems.enclosed import EnclosedSystem

Names = Mapping[str, str | tuple[str, ...]]
AXES = ("x", "y", "z")
_ELEMENT_PATTERN = re.compile(r"\[(\d+)\]$")
"""Index at the end of a name. Users count the values of a port from 0, as recordings do; roles count from 1, as FMUs
do."""
Side = Literal["input", "output"]
_PORT_SIDES: tuple[Side, Side] = ("input", "output")


@dataclass(frozen=True)
class SampledFmu:
    """The checked plan of an FMU or SSP that serves as controller, monitor or another part of the robot.

    Attributes:
        settings: values set before initialisation, for a single FMU.
        bindings: variable of each port, or of each value of a port.
        inputs, outputs: its ports, complete.
        tolerance: solver tolerance; None for the FMU's default.
        missing_inputs, missing_outputs: port values without a variable, counted from 0; these outputs are 0.
    """

    description: "FmuDescription | EnclosedSystem"
    settings: Sequence[Setting]
    bindings: tuple[Binding, ...]
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    tolerance: float | None
    missing_inputs: tuple[str, ...] = ()
    missing_outputs: tuple[str, ...] = ()

    def part(self, name: str, tick: float, period: int, ticks: int) -> Component:
        """Create the component, called once per period, with all ports of its role; output values it lacks are 0."""
        inputs, outputs = (self._ports(side) for side in _PORT_SIDES)
        made: Component
        if isinstance(self.description, FmuDescription):
            # the last call is at its last sample, and its step ends one period later, despite rounding
            last = ticks // period * period
            setup = Setup(self.tolerance, max((last + period) * tick, last * tick + period * tick), period * tick)
            folder = unpacked(self.description.path, self.description.sha256)
            made = FmuComponent(
                name, self.description, folder, inputs, outputs, self.settings, setup=setup, sampled=True
            )
        else:
            calls = ticks // period + 1
            made = self.description.component(name, inputs, outputs, tick, period, calls * period, sampled=True)
        made.period = period
        if not self.missing_inputs and not self.missing_outputs:
            made.inputs, made.outputs = self.inputs, self.outputs
            return made
        return Selection(made, self.inputs, self.outputs, *(self._slots(side) for side in _PORT_SIDES))

    def _ports(self, side: "Side") -> list[FmuPort]:
        mine = (b for b in self.bindings if b.role.causality == side)
        return [FmuPort(b.port, b.variable, b.gain, b.offset) for b in mine]

    def _slots(self, side: "Side") -> list[int]:
        """Return the position of each variable of the FMU among the values of all ports on one side."""
        at = port_slices(self.inputs if side == "input" else self.outputs)
        found: list[int] = []
        for binding in self.bindings:
            if binding.role.causality == side:
                begin, index = at[port_of(binding)].start, _ELEMENT_PATTERN.search(binding.role.port.name)
                first = begin + (int(index[1]) - 1 if index else 0)
                found += range(first, first + binding.variable.size)
        return found


def sampled_fmu(
    file: Path,
    table: str,
    ports: tuple[Sequence[Port], Sequence[Port]],
    required: Sequence[str],
    named: tuple[Names, Names],
    parameters: Mapping[str, Value],
    tolerance: float | None,
) -> SampledFmu:
    """Check an FMU for a part of the robot, such as the controller, and return its plan.

    Args:
        table: name of the experiment's table, for error messages.
        ports: inputs and outputs of the part.
        required: mandatory outputs; others are used if the FMU has them.
        named: variables by input and by output.
        parameters: values in the FMU's names and units.
    """
    description, settings = _read_part(file, table, named, parameters, tolerance)
    # an input with a parameter value keeps it
    free = {n: v for n, v in description.variables.items() if v.causality != "input" or n not in parameters}
    free, (inputs, outputs) = with_units(str(file), free, named)
    named = inputs, outputs
    fixed = description.variables.keys() - free.keys()
    named = (
        {name: of for name, of in named[0].items() if not {of, *(of if isinstance(of, tuple) else ())} & fixed},
        named[1],
    )
    found: tuple[Binding, ...] = ()
    lacking: dict[str, list[str]] = {}
    whole: dict[str, tuple[Port, ...]] = {}
    for side, offered, given in zip(_PORT_SIDES, ports, named, strict=True):
        for name in given:
            _refuse_unknown(file, table, side, name, given, offered)
        known = {role: name for port in offered for role, name in _roles(file, free, port, side, given)}
        wired = {role.port.name: name for role, name in known.items() if name}
        if side == "output":
            lone = {_ELEMENT_PATTERN.sub("", name) for name in given} - given.keys()
            needed = [port for port in offered if port.name in required and port.name not in lone]
            _refuse_missing_outputs(file, table, description, needed, wired)
        wiring = Wiring(inputs=wired) if side == "input" else Wiring(outputs=wired)
        mine = fill_roles(str(file), free, wiring, tuple(known), table)
        single = {_ELEMENT_PATTERN.sub("", name) for name in given if name not in {port.name for port in offered}}
        whole[side] = tuple(_complete_ports(file, table, mine, side, offered, single))
        lacking[side] = _missing_values(mine, [port for port in whole[side] if port.name in single])
        found += mine
    _refuse_odd_units(file, found)
    _refuse_unwired_inputs(file, table, description, found, parameters)
    own = description.tolerance if tolerance is None else tolerance
    unheard, zero = (tuple(lacking[side]) for side in _PORT_SIDES)
    return SampledFmu(description, settings, found, whole["input"], whole["output"], own, unheard, zero)


def _read_part(
    file: Path, table: str, named: tuple[Names, Names], parameters: Mapping[str, Value], tolerance: float | None
) -> "tuple[FmuDescription | EnclosedSystem, Sequence[Setting]]":
    """Load a part's FMU or SSP; return its description and the parameter values to set (empty for an SSP)."""
    if is_system(file):
        from twin.kernel.systems.enclosed import enclose_system

        if tolerance is not None:
            raise InputRefused(f"{file}: [{table}] tolerance: each FMU of an SSP has its own; remove it")
        texts = [of for side in named for one in side.values() for of in (one if isinstance(one, tuple) else (one,))]
        return enclose_system(file, table, parameters, [*texts, *(split_unit(text)[0] for text in texts)]), ()
    description = described(file)
    if description.kind != "co_simulation":
        raise InputRefused(f"{file}: model exchange only; a sampled part needs co-simulation, export it for that")
    return description, description.settings(parameters)


def _refuse_unknown(file: Path, table: str, side: Side, name: str, given: Names, offered: Sequence[Port]) -> None:
    """Refuse a mapped name that is neither a port of the role nor one of its values, such as `F_ee_B[2]`."""
    sizes = {port.name: port.size for port in offered}
    port, index = _ELEMENT_PATTERN.sub("", name), _ELEMENT_PATTERN.search(name)
    if port not in sizes:
        raise InputRefused(f"{file}: [{table}.{side}s] no {side} '{name}'; {nearest(port, sizes, 'it has {}')}")
    if index is None:
        return
    where = f"{file}: [{table}.{side}s] '{name}'"
    if int(index[1]) >= sizes[port]:
        raise InputRefused(f"{where}: {port} has {sizes[port]} values, counted from 0")
    if port in given:
        raise InputRefused(f"{where}: {port} is mapped as a whole, too; remove one of both")
    if not isinstance(given[name], str):
        raise InputRefused(f"{where}: it is one value; expected one variable")


def _missing_values(found: Sequence[Binding], ports: Sequence[Port]) -> list[str]:
    """Return the port values, such as `p_B[2]` counted from 0, that no FMU variable is mapped to."""
    there = {binding.role.port.name for binding in found}
    return [f"{port.name}[{i}]" for port in ports for i in range(port.size) if f"{port.name}[{i + 1}]" not in there]


def _roles(
    file: Path,
    variables: Mapping[str, Variable],
    port: Port,
    side: Side,
    given: Names,
) -> Iterator[tuple[Role, str]]:
    """Yield (role, variable) for a port, or for each of its values; the variable is "" if unknown."""
    named = given.get(port.name)
    single = {i: of for i in range(port.size) if (of := given.get(f"{port.name}[{i}]")) is not None}
    unit = known_unit(port.unit)
    # FMUs leave the radian out of dimensions
    dimension = unit.dimension._replace(rad=0) if unit else NUMBER
    if isinstance(named, str) and f"{named}[1]" in variables and named not in variables:
        named = tuple(f"{named}[{i + 1}]" for i in range(port.size))
    if isinstance(named, tuple) and len(named) != port.size:
        raise InputRefused(f"{file}: {port.name} has {port.size} values; {len(named)} variables are given for it")
    if single:
        for i, variable in single.items():
            one = Port(f"{port.name}[{i + 1}]", 1, port.unit, port.meaning, port.kind)
            yield Role(one, side, dimension, False, ()), str(variable)
    elif isinstance(named, str) or port.size == 1:
        yield Role(port, side, dimension, False, ()), named[0] if isinstance(named, tuple) else named or ""
    elif named is None and port.name in variables and variables[port.name].size == port.size:
        yield Role(port, side, dimension, False, ()), port.name
    else:
        for i in range(port.size):
            one = Port(f"{port.name}[{i + 1}]", 1, port.unit, port.meaning, port.kind)
            known = named[i] if named else _flattened_name(port, i, variables, side)
            yield Role(one, side, dimension, False, ()), known


def _flattened_name(port: Port, i: int, variables: Mapping[str, Variable], causality: str) -> str:
    """Return the FMU variable that holds one element of an array port, by the usual naming schemes; "" if missing."""
    name, n = port.name, i + 1
    ways = [f"{name}[{n}]", f"{name}({n})", f"{name}_{n}", f"{name}{n}"]
    if port.size == 3:
        ways += [f"{name}_{AXES[i]}", f"{name}.{AXES[i]}"]
    if port.size == 9:
        row, column = divmod(i, 3)
        ways += [f"{name}[{row + 1},{column + 1}]", f"{name}({row + 1},{column + 1})", f"{name}_{row + 1}{column + 1}"]
    there = (way for way in ways if way in variables and variables[way].causality == causality)
    return next(there, "")


def _refuse_missing_outputs(
    file: Path,
    table: str,
    description: "FmuDescription | EnclosedSystem",
    required: Sequence[Port],
    wired: Mapping[str, str],
) -> None:
    """Refuse an FMU without mapped required outputs; as several have the same unit, a mapping is not guessed."""
    for port in required:
        if port.name not in wired and not all(f"{port.name}[{i + 1}]" in wired for i in range(port.size)):
            offered = [f"{v.name}{f' [{v.unit}]' if v.unit else ''}" for v in description.variables_of("output")]
            names = '"..."' if port.size == 1 else "[" + ", ".join(['"..."'] * port.size) + "]"
            raise InputRefused(
                f"{file}: which of its outputs is {port.name} ({port.meaning}, {port.size} x {port.unit}), which a "
                f"{table} needs? It has {', '.join(offered) or 'none'}. Map it: [{table}.outputs] {port.name} = {names}"
            )


def port_of(binding: Binding) -> str:
    """Return the name of the port that a mapped variable fills, wholly or in part."""
    return binding.role.port.name.partition("[")[0]


def _complete_ports(
    file: Path, table: str, found: Sequence[Binding], side: str, offered: Sequence[Port], single: Collection[str]
) -> Iterator[Port]:
    """Yield an FMU's complete ports; refuse incomplete ports unless their values were mapped one by one."""
    mine = [binding for binding in found if binding.role.causality == side]
    sizes = {name: sum(binding.variable.size for binding in group) for name, group in groupby(mine, port_of)}
    for port in offered:
        if port.name not in sizes:
            continue
        if sizes[port.name] != port.size and port.name not in single:
            names = ", ".join(f'"{b.mapped_name}"' for b in mine if port_of(b) == port.name)
            raise InputRefused(
                f"{file}: {port.name} has {port.size} values, and {names} {sizes[port.name]}; give one for each: "
                f'[{table}.{side}s] {port.name} = ["...", ...]'
            )
        yield port


def _refuse_odd_units(file: Path, found: Sequence[Binding]) -> None:
    """Refuse FMU variables with a scaled unit for counts, flags and codes, which have no unit."""
    for binding in found:
        conversion = binding.variable.conversion
        if (
            binding.role.port.unit == "1"
            and conversion is not None
            and (conversion.factor, conversion.offset) != (1, 0)
        ):
            raise InputRefused(
                f"{file}: '{binding.name}' has unit '{binding.variable.unit}'; {binding.role.port.name} has none"
            )


def _refuse_unwired_inputs(
    file: Path,
    table: str,
    description: "FmuDescription | EnclosedSystem",
    found: Sequence[Binding],
    parameters: Collection[str],
) -> None:
    """Refuse an FMU with an input that neither robot nor parameter feeds: it would keep its start value."""
    fed = {binding.variable.name for binding in found} | set(parameters)
    unfed = [v.name for v in description.variables.values() if v.causality == "input" and v.name not in fed]
    if unfed:
        raise InputRefused(
            f"{file}: nothing feeds its input{'s' * (len(unfed) > 1)} {', '.join(unfed)}; map it in "
            f"[{table}.inputs], or give it a value in [{table}.parameters]"
        )


class Contract(NamedTuple):
    """The ports that a third-party part needs in its role; inputs, and outputs not in `required`, are optional."""

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    required: tuple[str, ...]


ROLE_CONTRACTS = {
    "body": Contract((), BODY_OUTPUTS, ("s_B", "v_s_B")),
    "estimator": Contract(ESTIMATOR_INPUTS, ESTIMATOR_OUTPUTS, ("p_B", "J", "F_ee_B")),
    "controller": Contract((*TASK_INPUTS, P_REF_B), TASK_OUTPUTS, ("omega_ref",)),
    "monitor": Contract(MONITOR_INPUTS, MONITOR_OUTPUTS, ("omega_ref", "tripped", "power")),
    "scale": Contract(SCALE_INPUTS, SCALE_OUTPUTS, ("F_z",)),
}
"""Contracts by role: the name of the robot's row, of the component and of the experiment's table."""


@dataclass(frozen=True)
class ThirdPartyPart:
    """A third-party part of the robot, checked but not yet created.

    Attributes:
        role: a key of `ROLE_CONTRACTS`.
        label: name in error messages.
        make: creates the component from the tick (s), its period in ticks and the last tick of the run.
        sha256: SHA-256 of the FMU or Python source; "" without a file.
        metadata: description of the part in recordings.
        fmu: description of the FMU or system; None for a Python class.
    """

    role: str
    label: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    make: Callable[[float, int, int], Component]
    sha256: str
    metadata: Mapping[str, Any]
    fmu: "FmuDescription | EnclosedSystem | None" = None

    @property
    def sentence(self) -> str:
        """Sentence about the third-party part for the user of a run: role, file and hash."""
        own = "twin's own, which has the law of the paper," if self.role == "controller" else "twin's own"
        zero = self.metadata.get("zero")
        lacking = f"; it does not give {', '.join(zero)}, taken as 0" if zero else ""
        return f"{self.role}: {self.label} (sha256 {self.sha256[:12]}); {own} did not run{lacking}"


def third_party_part(role: str, table: StandIn) -> ThirdPartyPart:
    """Check the third-party part that the experiment names for a role; a Python file is executed for this.

    Raises:
        InputRefused: file, hash, mapping, ports or parameters are invalid.
    """
    return _fmu_part(role, table) if table.fmu is not None else _class_part(role, table)


def third_party_parts(experiment: Experiment) -> dict[str, ThirdPartyPart]:
    """Check all third-party parts of an experiment, except parts that a study removed; return them by role."""
    gone = {role for role in ("monitor", "scale") if getattr(experiment, role) is None}
    return {role: third_party_part(role, table) for role, table in experiment.stand_ins.items() if role not in gone}


def part_sha256(role: str, table: StandIn) -> str:
    """Return the SHA-256 of the file of a third-party part, without executing the file."""
    if table.fmu is not None:
        return _fmu_part(role, table).sha256
    return _source(table).sha256


def part_from_class(role: str, given: Any) -> ThirdPartyPart:
    """Check a Python class or instance that a program passes as a part of the robot."""
    kind = given if isinstance(given, type) else type(given)
    contract = ROLE_CONTRACTS[role]
    wanted = declared_ports(kind.__name__, given, *contract)
    make = _maker(
        role, kind.__name__, lambda: make_instance(kind.__name__, kind, {}) if given is kind else given, wanted
    )
    file = None
    # interactively defined and compiled classes have no source file
    with suppress(TypeError, AttributeError):
        file = inspect.getsourcefile(kind)
    return ThirdPartyPart(role, kind.__name__, wanted[0].ports, wanted[1].ports, make, "", {"file": file})


def refuse_third_party_parts(experiment: Experiment, asker: str, roles: Sequence[str]) -> None:
    """Refuse an experiment with third-party parts in roles that a study, the `asker`, needs as twin's own."""
    for role in roles:
        if role in experiment.stand_ins:
            raise InputRefused(
                f"{experiment.name}: its {role} is {experiment.stand_ins[role].label}; {asker} knows the law of twin's "
                f"own {role} only. Remove fmu or python from [{role}]"
            )


def _fmu_part(role: str, table: StandIn) -> ThirdPartyPart:
    contract = ROLE_CONTRACTS[role]
    plan = sampled_fmu(
        table.file, role, (contract.inputs, contract.outputs), contract.required, (table.inputs, table.outputs),
        table.parameters, table.tolerance,
    )  # fmt: skip
    fmu = plan.description
    refuse_other_file(table.file, fmu.sha256, table.sha256)
    facts = {
        "file": fmu.path.name,
        "sha256": fmu.sha256,
        **origin_metadata(fmu),
        "tolerance": plan.tolerance,
        "set": {variable.name: to_json(value) for variable, value in plan.settings} or dict(table.parameters),
        "mapped": [
            *_mapping_lines(plan, plan.inputs, "input", "<-"),
            *_mapping_lines(plan, plan.outputs, "output", "->"),
            *(f"{name} = 0, as it does not give it" for name in plan.missing_outputs),
        ],
    } | ({"zero": list(plan.missing_outputs)} if plan.missing_outputs else {})

    def make(tick: float, period: int, ticks: int) -> Component:
        return plan.part(role, tick, period, ticks)

    return ThirdPartyPart(role, fmu.path.name, plan.inputs, plan.outputs, make, fmu.sha256, facts, fmu)


def origin_metadata(fmu: "FmuDescription | EnclosedSystem") -> dict[str, Any]:
    """Return the origin of an FMU, or of a system and its FMUs, for the metadata of a recording."""
    if isinstance(fmu, FmuDescription):
        model = fmu.model
        return {"model": model.modelName, "fmi": model.fmiVersion, "generation_tool": model.generationTool}
    return {"model": fmu.name, "fmi": f"SSP {fmu.version}", "generation_tool": None} | fmu.contents


def _mapping_lines(plan: SampledFmu, ports: Sequence[Port], side: str, arrow: str) -> list[str]:
    """Return a line about the mapped variables of each port: `p_B <- p_x, p_y, p_z [mm]`."""
    lines = []
    for port in ports:
        mine = [b for b in plan.bindings if b.role.causality == side and port_of(b) == port.name]
        unit = mine[0].variable.unit or "unit not stated"
        # indices of the mapped values, if the port is partial
        alone = [m for b in mine if (m := _ELEMENT_PATTERN.search(b.role.port.name))]
        some = alone and len(alone) < port.size
        name = f"{port.name}[{', '.join(str(int(m[1]) - 1) for m in alone)}]" if some else port.name
        lines.append(f"{name} {arrow} {', '.join(b.mapped_name for b in mine)} [{unit}]")
    return lines


def _class_part(role: str, table: StandIn) -> ThirdPartyPart:
    source = _source(table)
    # import time has no limit; the note lets a supervisor name the component at work
    with announce_call(source.file.name, role, "its import"):
        kind = source.load_class(table.class_name)
    contract = ROLE_CONTRACTS[role]
    wanted = declared_ports(table.label, kind, *contract)
    facts = {
        "file": source.file.name,
        "class": table.class_name,
        "sha256": source.sha256,
        "set": dict(table.parameters),
        "mapped": [
            f"{port.name} {arrow} [{side.units[port.name]}]"
            for side, arrow in zip(wanted, ("<-", "->"), strict=True)
            for port in side.ports
        ],
    }

    def model() -> Any:
        with announce_call(source.file.name, role, "its making"):
            return make_instance(table.label, kind, table.parameters)

    make = _maker(role, table.label, model, wanted)
    return ThirdPartyPart(role, table.label, wanted[0].ports, wanted[1].ports, make, source.sha256, facts)


def _maker(
    role: str, label: str, model: Callable[[], Any], wanted: tuple[DeclaredPorts, DeclaredPorts]
) -> Callable[[float, int, int], Component]:
    return lambda tick, period, ticks: PythonComponent(role, NamedPorts(model(), *wanted), period, label=label)


def _source(table: StandIn) -> PythonSource:
    source = PythonSource(table.file)
    refuse_other_file(table.file, source.sha256, table.sha256)
    return source
