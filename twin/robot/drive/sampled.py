"""An FMU as a sampled part of the robot: called at t_k with the inputs of t_k, its outputs are those of t_k.

A port of several values is one array of the FMU (FMI 3.0) or as many scalars, called as tools flatten arrays."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Literal

from twin.kernel.cosim.port import Port
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import FmuDescription, described
from twin.kernel.fmi.setting import Setting, Setup, Value
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.fmi.variable import Variable
from twin.kernel.units import NUMBER, known_unit
from twin.robot.drive.contract import Role
from twin.robot.drive.mapping import Binding, Wiring, filled

Said = Mapping[str, str | tuple[str, ...]]
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class SampledFmu:
    """An FMU for a part of the robot, checked as far as that goes without its binary.

    Attributes:
        description: of the FMU.
        settings: values set before initialisation.
        bindings: a variable for each port, or for each value of a port.
        inputs, outputs: ports that it has, whole.
        tolerance: of its solver; None: nothing is said.
    """

    description: FmuDescription
    settings: Sequence[Setting]
    bindings: tuple[Binding, ...]
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    tolerance: float | None

    def component(self, name: str, tick: float, period: int, ticks: int) -> FmuComponent:
        """The FMU in step mode, called every `period` ticks of `tick` (s) from tick 0 to tick `ticks`.

        Raises:
            InputRefused: it cannot be brought there.
        """
        inputs, outputs = (
            [FmuPort(b.port, b.variable, b.gain, b.offset) for b in self.bindings if b.role.causality == side]
            for side in _SIDES
        )
        # the last call is at the last of its samples, and its step goes on to the next, however that is rounded
        last = ticks // period * period
        stop = max((last + period) * tick, last * tick + period * tick)
        folder = unpacked(self.description.path, self.description.sha256)
        setup = Setup(self.tolerance, stop, period * tick)
        made = FmuComponent(name, self.description, folder, inputs, outputs, self.settings, setup=setup, sampled=True)
        made.inputs, made.outputs, made.period = self.inputs, self.outputs, period
        return made


Side = Literal["input", "output"]
_SIDES: tuple[Side, Side] = ("input", "output")


def sampled_fmu(
    file: Path,
    table: str,
    ports: tuple[Sequence[Port], Sequence[Port]],
    required: Sequence[str],
    said: tuple[Said, Said],
    parameters: Mapping[str, Value],
    tolerance: float | None,
) -> SampledFmu:
    """The FMU `file` for a part of the robot.

    Args:
        table: of the experiment that names it.
        ports: the part's inputs and outputs.
        required: outputs that it must have; all others are taken where the FMU has them.
        said: which variables are which inputs and outputs.
        parameters: in its own names and units.
        tolerance: of its solver; None: what it states itself.

    Raises:
        InputRefused: the FMU, the mapping or a parameter is not right; or it has an input that nothing feeds.
    """
    description = described(file)
    if description.kind != "co_simulation":
        raise InputRefused(
            f"{file}: model exchange alone; a part is called at its samples, export it for co-simulation"
        )
    settings = description.settings(parameters)
    # an input that has been given a value keeps it
    free = {n: v for n, v in description.variables.items() if v.causality != "input" or n not in parameters}
    fixed = description.variables.keys() - free.keys()
    said = (
        {name: of for name, of in said[0].items() if not {of, *(of if isinstance(of, tuple) else ())} & fixed},
        said[1],
    )
    found: tuple[Binding, ...] = ()
    whole: dict[str, tuple[Port, ...]] = {}
    for side, offered, given in zip(_SIDES, ports, said, strict=True):
        for name in given:
            if name not in [port.name for port in offered]:
                there = [port.name for port in offered]
                raise InputRefused(f"{file}: [{table}.{side}s] no {side} '{name}'; {nearest(name, there, 'it has {}')}")
        known = {role: name for port in offered for role, name in _roles(file, free, port, side, given)}
        told = {role.port.name: name for role, name in known.items() if name}
        if side == "output":
            _refuse_lacking(file, table, description, [port for port in offered if port.name in required], told)
        wiring = Wiring(inputs=told) if side == "input" else Wiring(outputs=told)
        mine = filled(str(file), free, wiring, tuple(known), table)
        whole[side] = tuple(_whole(file, table, mine, side, offered))
        found += mine
    _refuse_odd_units(file, found)
    _refuse_unfed(file, table, description, found, settings)
    own = description.tolerance if tolerance is None else tolerance
    return SampledFmu(description, settings, found, whole["input"], whole["output"], own)


def _roles(
    file: Path,
    variables: Mapping[str, Variable],
    port: Port,
    side: Side,
    given: Said,
) -> Iterator[tuple[Role, str]]:
    """Roles of a port, and the variable that plays each; "" where nobody knows."""
    said = given.get(port.name)
    unit = known_unit(port.unit)
    # as FMUs leave the radian out
    dimension = unit.dimension._replace(rad=0) if unit else NUMBER
    if isinstance(said, str) and f"{said}[1]" in variables and said not in variables:
        said = tuple(f"{said}[{i + 1}]" for i in range(port.size))
    if isinstance(said, tuple) and len(said) != port.size:
        raise InputRefused(f"{file}: {port.name} has {port.size} values; {len(said)} variables are given for it")
    if isinstance(said, str) or port.size == 1:
        yield Role(port, side, dimension, False, ()), said[0] if isinstance(said, tuple) else said or ""
    elif said is None and port.name in variables and variables[port.name].size == port.size:
        yield Role(port, side, dimension, False, ()), port.name
    else:
        for i in range(port.size):
            one = Port(f"{port.name}[{i + 1}]", 1, port.unit, port.meaning, port.kind)
            known = said[i] if said else _spelled(port, i, variables, side)
            yield Role(one, side, dimension, False, ()), known


def _spelled(port: Port, i: int, variables: Mapping[str, Variable], causality: str) -> str:
    """The variable that stands for value `i` of `port`, as tools flatten arrays; "" if there is none."""
    name, n = port.name, i + 1
    ways = [f"{name}[{n}]", f"{name}({n})", f"{name}_{n}", f"{name}{n}"]
    if port.size == 3:
        ways += [f"{name}_{AXES[i]}", f"{name}.{AXES[i]}"]
    if port.size == 9:
        row, column = divmod(i, 3)
        ways += [f"{name}[{row + 1},{column + 1}]", f"{name}({row + 1},{column + 1})", f"{name}_{row + 1}{column + 1}"]
    there = (way for way in ways if way in variables and variables[way].causality == causality)
    return next(there, "")


def _refuse_lacking(
    file: Path, table: str, description: FmuDescription, required: Sequence[Port], told: Mapping[str, str]
) -> None:
    """Nothing is guessed: a part of the robot has too many ports of one unit for that."""
    for port in required:
        if port.name not in told and not all(f"{port.name}[{i + 1}]" in told for i in range(port.size)):
            offered = [f"{v.name}{f' [{v.unit}]' if v.unit else ''}" for v in description.offered("output")]
            names = '"..."' if port.size == 1 else "[" + ", ".join(['"..."'] * port.size) + "]"
            raise InputRefused(
                f"{file}: which of its outputs is {port.name} ({port.meaning}, {port.size} x {port.unit}), which a "
                f"{table} needs? It has {', '.join(offered) or 'none'}. Say so: [{table}.outputs] {port.name} = {names}"
            )


def port_of(binding: Binding) -> str:
    """The port of which `binding` is a value, or all of them."""
    return binding.role.port.name.partition("[")[0]


def _whole(file: Path, table: str, found: Sequence[Binding], side: str, offered: Sequence[Port]) -> Iterator[Port]:
    """The ports that the FMU has, each with all of its values."""
    mine = [binding for binding in found if binding.role.causality == side]
    sizes = {name: sum(binding.variable.size for binding in group) for name, group in groupby(mine, port_of)}
    for port in offered:
        if port.name not in sizes:
            continue
        if sizes[port.name] != port.size:
            names = ", ".join(f'"{b.said}"' for b in mine if port_of(b) == port.name)
            raise InputRefused(
                f"{file}: {port.name} has {port.size} values, and {names} {sizes[port.name]}; give one for each: "
                f'[{table}.{side}s] {port.name} = ["...", ...]'
            )
        yield port


def _refuse_odd_units(file: Path, found: Sequence[Binding]) -> None:
    """Counts, flags and codes have no unit; a factor would make others of them."""
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


def _refuse_unfed(
    file: Path, table: str, description: FmuDescription, found: Sequence[Binding], settings: Sequence[Setting]
) -> None:
    """An input that nobody feeds would stay at its start value without a word."""
    fed = {binding.variable.name for binding in found} | {variable.name for variable, _ in settings}
    unfed = [v.name for v in description.variables.values() if v.causality == "input" and v.name not in fed]
    if unfed:
        raise InputRefused(
            f"{file}: nothing feeds its input{'s' * (len(unfed) > 1)} {', '.join(unfed)}; say which of ours it is in "
            f"[{table}.inputs], or give it a value in [{table}.parameters]"
        )
