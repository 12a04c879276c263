"""The test bench: drives run at a prescribed speed command and load, third-party parts called with recorded inputs.

Also lists the variables of an FMU for users who map them to roles.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.delay import play
from twin.kernel.cosim.port import by_port, width
from twin.kernel.cosim.signals import playback
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import StatePlaces
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, escape_controls
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.variable import Variable
from twin.robot.assembly.assemble import COMPONENT_ROWS
from twin.robot.assembly.drives import OMEGA_REF, DrivePlan, drive
from twin.robot.assembly.roles import ThirdPartyPart
from twin.robot.drive.contract import LOAD_ROLE, OUTPUT_ROLES
from twin.robot.drive.mapping import candidates
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.trace import Trace
from twin.studies.metrics.response import Curve
from twin.studies.qualify.definitions import TICK
from twin.studies.result import Block, Column, Table, lay_out

if TYPE_CHECKING:
    from twin.kernel.systems.enclosed import EnclosedSystem

MAX_VARIABLES = 60
"""Maximum number of variables listed per causality; longer lists are of no help."""


VARIABLE_COLUMNS = (Column("", 8, left=True, gap=2), Column("", 10, left=True), Column(folds=True))
SLICE_TICKS = 100
CHECK_TICKS = 500
"""Ticks between two checks for an early end of a run."""
CALLS_TIME_LIMIT = 5.0
"""Wall time (s) after which a slow part has been called often enough."""
CALLS_PER_BLOCK = 500
"""Number of calls between two checks of the wall time."""
NUDGE_SIZE = 1e-3
"""Change of inputs, relative or in SI, that reveals whether outputs respond: too small to have other consequences."""
MAX_MOTION = 1e9
"""Maximum angle (rad) and speed (rad/s). No shaft turns so far in any unit, and squares of it are finite."""


def variables_text(parts: "Mapping[str, FmuDescription | EnclosedSystem]") -> str:
    """List each FMU's inputs and outputs, and its locals if no output can be the angle; part "" is a single FMU."""
    blocks: list[Block] = []
    for part, fmu in parts.items():
        for causality, variables in _variables_by_causality(fmu).items():
            count = len(variables)
            blocks.append(f"{part or fmu.path.name}: {count or 'no'} {causality}{'s' * (count != 1)}")
            names = [escape_controls(v.name) for v in variables[:MAX_VARIABLES]]
            rows = [
                (name, v.type, f"[{v.unit}]" if v.unit else "-", v.description)
                for name, v in zip(names, variables, strict=False)
            ]
            name = Column(width=min(max(map(len, names), default=0), 32), left=True)
            blocks.append(Table([name, *VARIABLE_COLUMNS], rows))
            blocks += [f"  and {count - MAX_VARIABLES} more"] if count > MAX_VARIABLES else []
    return lay_out(blocks)


def variables_facts(parts: "Mapping[str, FmuDescription | EnclosedSystem]") -> list[dict[str, Any]]:
    """Return the variables of each FMU of a drive for JSON, without a limit on their number."""
    return [
        {
            "part": part, "name": v.name, "causality": causality, "type": v.type, "unit": v.unit or None,
            "description": v.description,
        }
        for part, fmu in parts.items()
        for causality, variables in _variables_by_causality(fmu).items()
        for v in variables
    ]  # fmt: skip


def _variables_by_causality(fmu: "FmuDescription | EnclosedSystem") -> dict[str, list[Variable]]:
    found = {c: [v for v in fmu.variables.values() if v.causality == c] for c in ("input", "output")}
    shaft = dict.fromkeys(name for role in OUTPUT_ROLES if role.required for name in candidates(fmu.variables, role))
    local = [v for name in shaft if (v := fmu.variables[name]).causality == "local"]
    return found | ({"local variable": local} if local else {})


@dataclass(frozen=True)
class Response:
    """Response of a drive on the bench, one sample per tick, all (ticks,).

    Speeds are in rad/s, the load in N m, the motor angle in rad; `cost` is the wall time in the drive's steps, per
    tick (s).
    """

    t: Curve
    omega_ref: Curve
    tau_load: Curve
    theta_m: Curve
    omega_m: Curve
    cost: float

    def window(self, start: float, end: float) -> slice:
        """Return the slice of the response's samples in start <= t < end (s)."""
        return slice(round(start / TICK), round(end / TICK))

    def mean_speed(self, start: float, end: float) -> float:
        """Return the mean speed (rad/s) in start <= t < end (s), by a line through the angle, averaging ripple."""
        part = self.window(start, end)
        t = self.t[part] - np.mean(self.t[part])
        return float(t @ (self.theta_m[part] - self.theta_m[part.start]) / (t @ t))


_tick_listeners: list[Callable[[int, float], None]] = []


@contextmanager
def reporting_ticks(hear: Callable[[int, float], None]) -> Iterator[None]:
    """Call `hear` during the block with the number of completed ticks and their wall time (s)."""
    _tick_listeners.append(hear)
    try:
        yield
    finally:
        _tick_listeners.remove(hear)


@contextmanager
def on_bench(plan: DrivePlan, tick: float, inputs: Curve) -> Iterator[System]:
    """Yield a test bench: a system of a drive and a component that plays back command and load.

    All axes of a three-axis drive get the same `inputs` (ticks, 2): commanded speed (rad/s) and load (N m), held from
    tick to tick (s).
    """
    ports = tuple(replace(port, size=plan.axes) for port in (OMEGA_REF, LOAD_ROLE.port))
    signals = playback(ports, np.repeat(inputs, plan.axes, axis=1))
    component = drive("drive", replace(plan, ticks=len(inputs)), tick, 0.0, float(inputs[0, 1]))
    try:
        wires = [(f"signals.{port.name}", f"drive.{port.name}") for port in component.inputs]
        yield System([signals, component], wires, tick)
    finally:
        component.close()


def response(
    plan: DrivePlan,
    omega_ref: Curve,
    tau_load: Curve,
    enough: Callable[[Curve], bool] = lambda theta_m: False,
) -> Response:
    """Run a drive on the bench from rest with a given command and load, and return its response.

    All axes of a three-axis drive get the same command and load; the first is measured.

    Args:
        omega_ref, tau_load: commanded speed (rad/s) and load (N m), held from tick to tick, (ticks,).
        enough: function of the angles so far (ticks,), called every half second; True ends the run early.

    Raises:
        InputRefused: the drive cannot be loaded or initialised, or refuses a tick of `TICK`.
        ComponentFailed: the drive returned an error, NaN, infinity, or a motion beyond `MAX_MOTION`.
    """
    with on_bench(plan, TICK, np.column_stack([omega_ref, tau_load])) as system:
        simulation = Simulation(system, len(omega_ref) - 1, SLICE_TICKS, timed=True)
        theta_m = system.columns("drive.theta_m").start
        rows = np.empty((len(omega_ref), system.outputs_width))
        elapsed = 0.0
        while not simulation.is_over:
            first = simulation.next_tick
            began = time.perf_counter()
            slice_ = simulation.advance()
            taken = time.perf_counter() - began
            elapsed += taken
            rows[first : simulation.next_tick] = slice_
            for hear in _tick_listeners:
                hear(len(slice_), taken)
            if simulation.next_tick % CHECK_TICKS == 0 and enough(rows[: simulation.next_tick, theta_m]):
                break
        if simulation.failure:
            raise simulation.failure
    rows = rows[: simulation.next_tick]
    refuse_impossible(plan, system, rows)
    of_drive = simulation.cycles[system.components.index(system.component("drive"))] / simulation.cycles.sum()
    return Response(
        t=TICK * np.arange(len(rows), dtype=float),
        omega_ref=rows[:, system.columns("signals.omega_ref").start],
        tau_load=rows[:, system.columns("signals.tau_load").start],
        theta_m=rows[:, theta_m],
        omega_m=rows[:, system.columns("drive.omega_m").start],
        cost=float(of_drive * elapsed / len(rows)),
    )


def refuse_impossible(plan: DrivePlan, system: System, rows: Curve) -> None:
    """Refuse finite but physically impossible motion in `rows` (ticks, outputs) of a system by `on_bench`."""
    motion = rows[:, [system.columns(f"drive.{name}").start for name in ("theta_m", "omega_m")]]
    beyond = np.abs(motion) > MAX_MOTION
    if beyond.any():
        k = int(np.flatnonzero(beyond.any(axis=1))[0])
        name, unit = (("theta_m", "rad"), ("omega_m", "rad/s"))[int(np.argmax(beyond[k]))]
        value = motion[k, int(np.argmax(beyond[k]))]
        raise ComponentFailed(
            f"{plan.label} returned {name} = {value:.3g} {unit} at t = {k * TICK:.6g} s; too fast for a shaft; "
            "check its units and its step size"
        )


@dataclass(frozen=True)
class Inputs:
    """Recorded inputs of a robot part: sampling times t (n,), s, sampling period (s), inputs u (n, inputs), SI."""

    t: NDArray[np.float64]
    period: float
    u: NDArray[np.float64]

    def first(self, count: int) -> "Inputs":
        return replace(self, t=self.t[:count], u=self.u[:count])

    def skip(self, count: int) -> "Inputs":
        return replace(self, t=self.t[count:], u=self.u[count:])

    def nudge(self) -> "Inputs":
        """Return the inputs with a small change of each value, alternating in sign."""
        signs = np.where(np.arange(self.u.shape[1]) % 2, 1.0, -1.0)
        return replace(self, u=self.u + NUDGE_SIZE * signs * np.maximum(np.abs(self.u), 1.0))


@dataclass(frozen=True)
class PartCalls:
    """Outputs of a series of calls of a robot part, and wall time per call (s).

    Attributes:
        rows: outputs (calls, outputs); fewer calls than inputs if one failed, or they took too long.
        failure: error of the call after the last row, as the verb phrase of a sentence; "" if all calls succeeded.
    """

    rows: NDArray[np.float64]
    failure: str
    cost: float


def inputs_for(part: ThirdPartyPart, run: Trace, experiment: Experiment, period: int) -> Inputs:
    """Return the inputs that a part called every `period` (ticks) would have received in a recorded run."""
    (row,) = [row for row in COMPONENT_ROWS if row.name == part.role]
    ticks = np.arange(0, experiment.duration_ticks + 1, period)
    columns = [np.zeros((len(ticks), 0))]
    for port in part.inputs:
        # A controller of twin's own has its reference path built in.
        sources = [f"{name}.{output}" for name, output in (*row.inputs[port.name], (part.role, port.name))]
        name = next(source for source in sources if source in run.fields())
        columns.append(run.held(name)[ticks].reshape(len(ticks), port.size).astype(float))
    tick = experiment.cosim.tick
    return Inputs(np.asarray(ticks * tick), period * tick, np.hstack(columns))


def call_part(component: Component, inputs: Inputs) -> PartCalls:
    """Call a robot part's component at all samples of its inputs, until `CALLS_TIME_LIMIT`."""
    blocks: list[NDArray[np.float64]] = []
    # A call without samples compiles the code, or loads it from the cache, before the clock starts.
    play(component, inputs.t[:0], inputs.t[:0], inputs.u[:0])
    began, failure, done = time.perf_counter(), "", 0
    while done < len(inputs.t) and not failure and time.perf_counter() - began < CALLS_TIME_LIMIT:
        block = slice(done, done + CALLS_PER_BLOCK)
        t = inputs.t[block]
        rows, status = play(component, t, np.full(len(t), inputs.period), inputs.u[block])
        finite = np.isfinite(rows).all(axis=1)
        good = len(rows) if finite.all() else int(np.argmin(finite))
        if good < len(t):
            failure = component.explain(status) if good == len(rows) else not_finite(component, rows[good])
        blocks.append(rows[:good])
        done += good
    rows = np.concatenate(blocks) if blocks else np.empty((0, width(component.outputs)))
    return PartCalls(rows, failure, (time.perf_counter() - began) / max(1, done))


def not_finite(component: Component, row: NDArray[np.float64]) -> str:
    """Return an error for outputs that are NaN or infinite, as the verb phrase of a sentence."""
    names = [name for name, values in by_port(component.outputs, row).items() if not np.isfinite(values).all()]
    return f"returned NaN or infinity for {', '.join(names)}"


def repeats_from_state(component: Component, inputs: Inputs) -> bool:
    """Whether a part repeats its bits from a restored state; raise `TwinError` if it has no usable state."""
    half = len(inputs.t) // 2
    call_part(component, inputs.first(half))
    nothing = np.zeros(0)
    places = StatePlaces([component], nothing, nothing)
    state = places.save_state(0)
    once = call_part(component, inputs.skip(half))
    places.restore_state(state)
    state.close()
    again = call_part(component, inputs.skip(half))
    if once.failure or again.failure:
        raise ComponentFailed(f"{component.label}: {once.failure or again.failure}")
    count = min(len(once.rows), len(again.rows))
    return bool(np.array_equal(once.rows[:count], again.rows[:count]))
