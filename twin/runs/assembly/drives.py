"""From a joint's [drive] table to a plan that has passed every check which needs no binary."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from twin.cosim.port import Port
from twin.drive.contract import COMMANDS, OMEGA_M, SHAFT, THETA_M
from twin.drive.description import FmuDescription, described
from twin.drive.mapping import Binding, Wiring, bindings
from twin.drive.setting import Setting
from twin.drive.solvers import USUAL_TOLERANCE, Solver
from twin.drive.unpacked import unpacked
from twin.drive.variable import Variable
from twin.errors import InputRefused
from twin.experiment.schema import Drive

Start = float | np.ndarray
ENABLE = "enable"
"""The optional role by which a drive's power is switched."""
ALONE = ""
"""Name of the only part of a drive that is one FMU."""


@dataclass(frozen=True)
class DrivePlan:
    """A drive that has passed every check that needs no binary.

    Attributes:
        label: what an error calls it.
        table: what the experiment says.
        parts: the FMUs by part.
        settings: values set in each.
        bindings: the roles it fills.
        wires: (output, input) between parts, "part.variable" each.
        switched: whether its role `enable` is an input of the component; else it keeps the value it was given.
        ticks: how many it will be stepped; None: nobody knows.
        ramped: whether it is offered its inputs as lines over a step.
        folders: by their SHA-256, of FMUs whose unpacked files have been looked at for the same robot; None: they are
            looked at whenever a component is made.
    """

    label: str
    table: Drive
    parts: dict[str, FmuDescription]
    settings: Mapping[str, Sequence[Setting]]
    bindings: tuple[Binding, ...]
    wires: tuple[tuple[str, str], ...]
    switched: bool = False
    ticks: int | None = None
    ramped: bool = False
    folders: dict[str, Path] | None = field(default=None, compare=False, repr=False)

    def folder(self, part: str) -> Path:
        """Of the unpacked FMU of a part.

        Raises:
            InputRefused: it cannot be written there.
        """
        fmu = self.parts[part]
        known = {} if self.folders is None else self.folders
        if fmu.sha256 not in known:
            known[fmu.sha256] = unpacked(fmu.path, fmu.sha256)
        return known[fmu.sha256]

    def switchable(self) -> "DrivePlan":
        """The same drive with `enable` as an input, if it has that role and the experiment does not fix it."""
        fixed = {qualified(part, v.name) for part, settings in self.settings.items() for v, _ in settings}
        return replace(self, switched=any(b.port.name == ENABLE and b.name not in fixed for b in self.bindings))

    def until(self, ticks: int | None) -> "DrivePlan":
        """The same drive for a run of so many `ticks`; None: nobody knows."""
        return replace(self, ticks=ticks)

    def with_lines(self) -> "DrivePlan":
        """The same drive, offered its inputs as lines over a step."""
        return replace(self, ramped=True)

    def tolerance(self, part: str) -> float | None:
        """Of the solver of a part, as the experiment says, or else the FMU itself; for a CVODE of ours there is one."""
        own = self.table.parts[part].tolerance if part else None
        said = self.table.tolerance if own is None else own
        said = self.parts[part].tolerance if said is None else said
        solver = self.solver(part)
        return USUAL_TOLERANCE if said is None and solver is not None and solver.method == "cvode" else said

    def solver(self, part: str) -> Solver | None:
        """Of ours, for the equations of a part; None: it brings its own, being for co-simulation."""
        if self.parts[part].kind == "co_simulation":
            return None
        own = self.table.parts[part] if part else self.table
        step = self.table.solver_step if own.solver_step is None else own.solver_step
        return Solver(own.solver or self.table.solver or "cvode", step)

    @property
    def is_bare(self) -> bool:
        """Whether nothing of ours stands between its FMU and the robot."""
        return self.table.velocity_loop is self.table.rotor is None and self.table.command != "position"

    @property
    def axes(self) -> int:
        """How many joints one instance drives: 1 or 3."""
        return self.port(COMMANDS[self.table.command].port.name).size

    def port(self, name: str) -> Port:
        """The port of the role `name`, which it fills."""
        return next(b.port for b in self.bindings if b.port.name == name)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """The contract's outputs that it offers, those of a rotor of ours first."""
        own = (THETA_M.port, OMEGA_M.port) if self.table.rotor else ()
        return (*own, *(b.port for b in self.bindings if b.role.causality == "output"))

    def warnings(self) -> list[str]:
        """What may go wrong although the drive is accepted."""
        loops = [
            f"{name} depends directly on {load.name} (ModelStructure). With the spring that makes an algebraic loop, "
            "tau_load = k_s (theta_m - N theta_l); the master breaks it by one step of delay, which costs accuracy "
            "and, above a gain of 1, stability. Export the drive with theta_m as a state, or raise [drive] substeps"
            for load in self.bindings
            if load.port.name == "tau_load"
            for name in self._fed_through(load.name)
        ]
        unstated = [b.port for b in self.bindings if not b.variable.unit]
        if self.table.rotor and not any(b.role in SHAFT for b in self.bindings):
            loops.append("it is not told how its shaft turns; if it has an input for that: [drive.inputs] omega_m")
        return loops + [f"{port.name}: the FMU states no unit; taken as {port.unit}" for port in unstated]

    def _fed_through(self, load: str) -> list[str]:
        """Roles of motion that the FMU says depend on the load without any delay."""
        motion = {b.name: b.port.name for b in self.bindings if b.port.name in ("theta_m", "omega_m")}
        return [
            motion[name]
            for part, description in self.parts.items()
            for unknown in description.model.outputs
            if (name := qualified(part, unknown.variable.name)) in motion
            and any(qualified(part, known.name) == load for known in unknown.dependencies or ())
        ]


def planned(table: Drive) -> DrivePlan:
    """Check a drive as far as that goes without loading it.

    Raises:
        InputRefused: an FMU, its hash, the mapping, a parameter or a wire is not right.
    """
    parts = fmus(table)
    given = {name: part.parameters for name, part in table.parts.items()} or {ALONE: table.parameters}
    parts = {name: description.resized(given[name]) for name, description in parts.items()}
    variables = {
        qualified(part, v.name): v for part, description in parts.items() for v in description.variables.values()
    }
    label = " + ".join(dict.fromkeys(d.path.name for d in parts.values()))
    wiring = Wiring(table.command, table.sign, table.gear_ratio, table.inputs, table.outputs, table.rotor is not None)
    free = {name: v for name, v in variables.items() if name not in table.wires}
    plan = DrivePlan(
        label=label,
        table=table,
        parts=parts,
        settings={name: parts[name].settings(values) for name, values in given.items()},
        bindings=bindings(label, free, wiring),
        wires=tuple(_checked_wire(label, variables, source, target) for target, source in table.wires.items()),
    )
    _refuse_idle_solvers(plan)
    if plan.axes > 1 and not plan.is_bare:
        ours = "rotor turns" if table.rotor else "loop drives"
        raise InputRefused(f"{label}: three axes in one FMU with a {table.command} command; our {ours} one axis")
    return plan


def fmus(table: Drive) -> dict[str, FmuDescription]:
    """The FMUs of a drive by part.

    Raises:
        InputRefused: one cannot be used, or is not the one that was meant.
    """
    files = {name: (part.fmu, part.sha256, part.kind or table.kind) for name, part in table.parts.items()}
    files = files or {ALONE: (table.fmu or "", table.sha256, table.kind)}
    found = {}
    for name, (fmu, digest, kind) in files.items():
        found[name] = described(Path(fmu), kind)
        refuse_other_file(found[name].path, found[name].sha256, digest)
    return found


def _refuse_idle_solvers(plan: DrivePlan) -> None:
    """A solver that is named has to have equations to solve."""
    named = {name: part.solver for name, part in plan.table.parts.items()}
    if plan.table.solver and all(fmu.kind == "co_simulation" for fmu in plan.parts.values()):
        named[next(iter(plan.parts))] = plan.table.solver
    for part, method in named.items():
        fmu = plan.parts[part]
        if method and fmu.kind == "co_simulation":
            remedy = 'say kind = "model_exchange"' if len(fmu.kinds) > 1 else "remove it"
            raise InputRefused(f'{fmu.path}: solver = "{method}", and it brings its own for co-simulation; {remedy}')


def refuse_other_file(file: Path, sha256: str, pinned: str | None) -> None:
    """The experiment has to mean the `file` of that hash, or to say nothing.

    Raises:
        InputRefused: it pins another hash.
    """
    if pinned is not None and pinned.lower() != sha256:
        raise InputRefused(
            f"{file}: has sha256 {sha256}; the experiment pins {pinned.lower()}. It is not the file that was meant: "
            "get that, or change sha256"
        )


def qualified(part: str, variable: str) -> str:
    """What the user calls a variable of a part: `machine.R`."""
    return f"{part}.{variable}" if part else variable


def belongs(part: str, name: str) -> bool:
    """Whether `name`, as the user calls it, is that of a variable of `part`."""
    return part == ALONE or name.startswith(f"{part}.")


def _checked_wire(label: str, variables: dict[str, Variable], source: str, target: str) -> tuple[str, str]:
    for end, wanted in ((source, ("output", "local")), (target, ("input",))):
        if end not in variables:
            raise InputRefused(f"{label}: [drive.wires] '{end}': no such variable; write part.variable")
        if variables[end].causality not in wanted:
            raise InputRefused(
                f"{label}: [drive.wires] '{end}' has causality {variables[end].causality}; expected {wanted[0]}"
            )
    a, b = variables[source].conversion, variables[target].conversion
    if a and b and a.dimension != b.dimension:
        raise InputRefused(
            f'{label}: [drive.wires] "{target}" = "{source}": units \'{variables[target].unit}\' and '
            f"'{variables[source].unit}' do not measure the same"
        )
    return source, target
