"""The bench: a drive at a commanded speed and a load, both known beforehand; a part at what it would get in a run.

The variables of an FMU, listed for a user who maps them to roles.
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
"""Variables of a causality that are listed; a list of thousands is of no help."""


VARIABLE_COLUMNS = (Column("", 8, left=True, gap=2), Column("", 10, left=True), Column(folds=True))
"""Columns beside the name of a variable."""
SLICE_TICKS = 100
CHECK_TICKS = 500
"""Ticks after which it is asked whether a run has seen enough."""
CALLS_TIME_LIMIT = 5.0
"""Wall time (s) after which a part that is slow has been called often enough."""
CALLS_PER_BLOCK = 500
"""Calls between two looks at the clock."""
NUDGE_SIZE = 1e-3
"""By which inputs are changed, of their size or in SI, to see what follows: less than anybody would notice."""
MAX_MOTION = 1e9
"""rad and rad/s. No shaft turns so far, whatever its units are; and squares of it are numbers still."""


def variables_text(parts: "Mapping[str, FmuDescription | EnclosedSystem]") -> str:
    """The inputs and outputs of each part; of what is local, what its shaft may be where no output can.

    Args:
        parts: FMUs by part; "" for the only one.
    """
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
    """The same for JSON, all of them."""
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
    """What a drive did, one sample per tick, all (ticks,).

    Attributes:
        t: s.
        omega_ref, omega_m: rad/s.
        tau_load: N m.
        theta_m: rad.
        cost: wall time in the drive's steps, per tick (s).
    """

    t: Curve
    omega_ref: Curve
    tau_load: Curve
    theta_m: Curve
    omega_m: Curve
    cost: float

    def window(self, start: float, end: float) -> slice:
        """The samples in start <= t < end (s)."""
        return slice(round(start / TICK), round(end / TICK))

    def mean_speed(self, start: float, end: float) -> float:
        """Mean speed (rad/s) in a window of time (s): slope of a line through the angle, so ripple averages out."""
        part = self.window(start, end)
        t = self.t[part] - np.mean(self.t[part])
        return float(t @ (self.theta_m[part] - self.theta_m[part.start]) / (t @ t))


TickListener = Callable[[int, float], None]
_tick_listeners: list[TickListener] = []


@contextmanager
def reporting_ticks(hear: TickListener) -> Iterator[None]:
    """Within the block `hear` is called with how many ticks are over, and how long they took (s), as they come."""
    _tick_listeners.append(hear)
    try:
        yield
    finally:
        _tick_listeners.remove(hear)


@contextmanager
def on_bench(plan: DrivePlan, tick: float, inputs: Curve) -> Iterator[System]:
    """A system of "signals", which plays `inputs` back, and a fresh instance of the drive, "drive", at theta_m = 0.

    Args:
        plan: the drive; all axes of one of three are commanded and loaded alike.
        tick: s.
        inputs: commanded speed (rad/s) and load (N m), held from tick to tick, (ticks, 2).

    Raises:
        InputRefused: the drive cannot be loaded or initialised, or does not take such a tick.
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
    """Run a fresh instance of the drive from rest at theta_m = 0.

    All axes of a drive of three are commanded and loaded alike, and the first is looked at.

    Args:
        plan: the drive.
        omega_ref, tau_load: commanded speed (rad/s) and load (N m), held from tick to tick, (ticks,).
        enough: asked with the angles so far (ticks,) after every half second; True ends the run early.

    Raises:
        InputRefused: the drive cannot be loaded or initialised, or does not take a tick of `TICK`.
        ComponentFailed: it returned an error, NaN, infinity, or what no shaft can do.
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
    """Refuse numbers of which no others can be made.

    Args:
        plan: the drive.
        system: of `on_bench`.
        rows: of its outputs (ticks, outputs), finite.

    Raises:
        ComponentFailed: angle or speed are beyond all measure.
    """
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
    """What a part gets at each of its samples.

    Attributes:
        t: times of the samples (n,), s.
        period: between two of them (s).
        u: (n, inputs), SI.
    """

    t: NDArray[np.float64]
    period: float
    u: NDArray[np.float64]

    def first(self, count: int) -> "Inputs":
        """The first samples."""
        return replace(self, t=self.t[:count], u=self.u[:count])

    def skip(self, count: int) -> "Inputs":
        """All but the first samples."""
        return replace(self, t=self.t[count:], u=self.u[count:])

    def nudge(self) -> "Inputs":
        """Each a little different, and none as the one before."""
        signs = np.where(np.arange(self.u.shape[1]) % 2, 1.0, -1.0)
        return replace(self, u=self.u + NUDGE_SIZE * signs * np.maximum(np.abs(self.u), 1.0))


@dataclass(frozen=True)
class PartCalls:
    """What a part made of inputs.

    Attributes:
        rows: outputs (calls, outputs); fewer calls than asked for if one failed, or they took too long.
        failure: of the call after the last row, as the verb phrase of a sentence; "" if none failed.
        cost: wall time per call (s).
    """

    rows: NDArray[np.float64]
    failure: str
    cost: float


def inputs_for(part: ThirdPartyPart, run: Trace, experiment: Experiment, period: int) -> Inputs:
    """What `part` would have got in the `run` of `experiment`.

    Args:
        period: of the part, in ticks.
    """
    (row,) = [row for row in COMPONENT_ROWS if row.name == part.role]
    ticks = np.arange(0, experiment.duration_ticks + 1, period)
    columns = [np.zeros((len(ticks), 0))]
    for port in part.inputs:
        # a controller of twin's own brings its way itself
        sources = [f"{name}.{output}" for name, output in (*row.inputs[port.name], (part.role, port.name))]
        name = next(source for source in sources if source in run.fields())
        columns.append(run.held(name)[ticks].reshape(len(ticks), port.size).astype(float))
    tick = experiment.cosim.tick
    return Inputs(np.asarray(ticks * tick), period * tick, np.hstack(columns))


def call_part(component: Component, inputs: Inputs) -> PartCalls:
    """Call `component` at the samples of `inputs`, for as long as there is patience."""
    blocks: list[NDArray[np.float64]] = []
    # no call: compiles, or loads from the cache, before the clock runs
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
    """Which output of `row` is no number, as the verb phrase of a sentence."""
    names = [name for name, values in by_port(component.outputs, row).items() if not np.isfinite(values).all()]
    return f"returned NaN or infinity for {', '.join(names)}"


def repeats_from_state(component: Component, inputs: Inputs) -> bool:
    """Whether the second half of `inputs` gives the same bits when the FMU is set back to where it began.

    Raises:
        ComponentFailed: the FMU refuses to save or restore its state. InputRefused: its state is known to be none.
    """
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
