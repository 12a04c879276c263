"""Python interface to co-simulation: load, wire, step, read, set, save and observe systems of FMUs.

`twin cosim` uses the same plan and the same loop, so results have the same bits.
"""

import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import numpy as np

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.interpolation import Scheme
from twin.kernel.cosim.port import port_slices
from twin.kernel.cosim.python_class import PythonComponent, PythonModel
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState, SystemState
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import described
from twin.kernel.fmi.variable import MAX_EXACT, Value, Variable, setting_value
from twin.kernel.recording.messages import FIELD_NAME
from twin.kernel.recording.writer import EVENTS_TOPIC
from twin.kernel.ssp import structure as ssp
from twin.kernel.ssp.package import loose_package
from twin.kernel.systems.additions import Additions, setting_text
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.coupling import PreparedSystem
from twin.kernel.systems.extras import Feed, SystemExtras
from twin.kernel.systems.fed_inputs import INPUTS_TOPIC
from twin.kernel.systems.naming import match_names
from twin.kernel.systems.opening import open_system
from twin.kernel.systems.plan import SystemPlan
from twin.kernel.systems.reading import read_system

FORM_NAME = "Python"
_PORT_PATTERN = re.compile(r"(?P<name>[^\[]+)(\[\d+\])?")


class ObservedSeries:
    """Observed signals: `series["motor.omega"]` is (n,) or (n, size), `series.t` the times (s), (n,)."""

    def __init__(self, columns: Mapping[str, slice], tick: float):
        self._columns, self._tick = columns, tick
        self._rows: list[np.ndarray] = []
        self._first = self._next = 0

    @property
    def names(self) -> list[str]:
        """Names of the observed signals."""
        return list(self._columns)

    @property
    def t(self) -> np.ndarray:
        """Times of the rows (s), shape (n,)."""
        return self._tick * np.arange(self._first, self._next)

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the values of a signal, shape (n,) or (n, size); InputRefused if it is not observed."""
        if name not in self._columns:
            raise InputRefused(f"'{name}' is not observed; {nearest(name, self._columns, 'it has {}')}")
        place = self._columns[name]
        values = np.concatenate([np.empty((0, place.stop - place.start)), *(rows[:, place] for rows in self._rows)])
        return values[:, 0] if place.stop - place.start == 1 else values

    def _append(self, first: int, rows: np.ndarray) -> None:
        if not self._rows or first < self._first:
            self._rows, self._first = [], first
        # drop rows after a restored state
        while self._rows and self._next > first:
            last = self._rows.pop()
            self._next -= len(last)
            if self._next < first:
                self._rows.append(last[: first - self._next])
                self._next = first
        self._rows.append(rows)
        self._next = first + len(rows)


class Cosimulation:
    """A co-simulation of FMUs and Python components, until `stop` (s) at the latest, which is also passed to FMUs.

    `tick` is the step size (s); None for the step size of the file read, or the shortest that an FMU states. In the
    `scheme` "gauss_seidel" components step in load order, each with the newest values of those before it; in "jacobi"
    all use the values from the start of the step.
    """

    def __init__(self, tick: float | None = None, stop: float | None = None, scheme: Scheme | None = None):
        self._tick, self._stop, self._scheme = tick, stop, scheme
        self._files: dict[str, Path] = {}
        self._others: dict[str, Component] = {}
        self._order: list[str] = []
        self._wires: list[tuple[str, str, ssp.Transformation]] = []
        self._settings: dict[str, str] = {}
        self._inputs: list[str] = []
        self._system: Path | None = None
        self._watched: list[tuple[ObservedSeries, np.ndarray]] = []
        self._open = ExitStack()
        self._running: tuple[SystemPlan, PreparedSystem, Simulation] | None = None

    @classmethod
    def read(
        cls, file: str | Path, tick: float | None = None, stop: float | None = None, scheme: Scheme | None = None
    ) -> Self:
        """Open a file's system, like `twin cosim`; arguments as of the class. InputRefused if missing or invalid."""
        made = cls(tick, stop, scheme)
        made._system = Path(file)
        read_system(made._system)
        return made

    def load(self, name: str, fmu: str | Path, start: Mapping[str, Value] | None = None, **more: Value) -> None:
        """Add an FMU as the component `name`: letters, digits and _.

        `start` and `more` are values of parameters and inputs before initialisation, in the FMU's units. InputRefused:
        an invalid FMU, or a name in use; an invalid value is refused at the first step.
        """
        self._register_name(name)
        described(Path(fmu))
        self._files[name] = Path(fmu)
        for variable, value in {**(start or {}), **more}.items():
            self._settings[f"{name}.{variable}"] = setting_text(value)

    def add(
        self, name: str, model: PythonModel | Component, period: int = 1, initial: Sequence[float] | None = None
    ) -> None:
        """Add a component that is not an FMU, with a step of `period` ticks.

        `model` has `inputs`, `outputs`, `sampled` and `step(t, h, u, y)`, or is a `Component`. `initial` are its
        outputs before the first step, None for zeros. InputRefused: the name is in use.
        """
        self._register_name(name)
        if isinstance(model, Component):
            model.name = name
            self._others[name] = model
        else:
            self._others[name] = PythonComponent(name, model, period, initial)

    def wire(self, output: str, input: str, factor: float = 1.0, offset: float = 0.0) -> None:
        """Connect "component.output" with "component.input", with unit conversion.

        The input gets factor * value + offset; only between FMUs. InputRefused: the system is already running.
        """
        self._refuse_running("wires")
        self._wires.append((output, input, ssp.Transformation(factor, offset)))

    def feed(self, input: str, signal: str) -> None:
        """Connect an input to a signal over time: an expression, `FILE.csv:COLUMN` or `RUN.mcap:SIGNAL`.

        InputRefused: the system is already running. An invalid signal is refused at the first step.
        """
        self._refuse_running("signals")
        self._inputs.append(f"{input}={signal}")

    def step(self, ticks: int = 1) -> None:
        """Advance by a number of ticks; the first call initialises the system.

        InputRefused: the system cannot be set up, or the steps exceed `stop`; ComponentFailed: a component failed,
        observed rows until then are kept.
        """
        _, _, simulation = self._running_parts()
        if ticks < 1 or simulation.next_tick + ticks > simulation.last_tick + 1:
            left = simulation.last_tick + 1 - simulation.next_tick
            raise InputRefused(f"{ticks} steps at t = {self.t:g} s; expected 1 .. {left}, until stop")
        self._advance(ticks)

    def run(self) -> None:
        """Advance to `stop`, which is the time of the last row. Errors as in `step`."""
        _, _, simulation = self._running_parts()
        self._advance(simulation.last_tick + 1 - simulation.next_tick)

    @property
    def t(self) -> float:
        """Current time of the system (s)."""
        plan, _, simulation = self._running_parts()
        return min(simulation.next_tick, simulation.last_tick) * plan.timing.tick

    def get(self, name: str) -> float | np.ndarray:
        """Read the value of "component.variable" in the FMU's own unit: a number, or (size,) for an array.

        InputRefused: no such variable, or not a number. ComponentFailed: the FMU does not return the value.
        """
        component, variable = self._place(name)
        simulation = self._running_parts()[2]
        if isinstance(component, FmuComponent):
            found = self._variable(component, variable)
            if found.kind < 0:
                raise InputRefused(f"{name} is {found.type}; expected a number")
            exact = component.instance.values(found)
            # exact integers of 64 bits: unlike a signal, the value need not be a double
            large = any(isinstance(value, int) and abs(value) > MAX_EXACT for value in exact)
            values = np.array(exact, dtype=object if large else float)
        else:
            ports = port_slices(component.outputs)
            if variable not in ports:
                raise InputRefused(f"{component.name} has no output '{variable}'; {nearest(variable, ports)}")
            values = simulation.outputs(component)[ports[variable]].copy()
        return values.tolist()[0] if len(values) == 1 else values

    def set(self, name: str, value: Value) -> None:
        """Set the variable "component.variable"; the value remains until the next call.

        Before the first step, parameters, inputs and variables with a start value can be set; later, inputs without a
        source and tunable parameters. InputRefused: it cannot be set, or not to this value. ComponentFailed: the FMU
        refuses it.
        """
        if self._running is None:
            self._settings[name] = setting_text(value)
            return
        component, variable = self._place(name)
        if not isinstance(component, FmuComponent):
            raise InputRefused(f"{component.name} is not an FMU; set an attribute of its object")
        found = self._variable(component, variable)
        fed = {port.variable.name for port in component.ports[0]}
        if found.name in fed:
            raise InputRefused(f"{name} is fed by a connection; remove that, or set what feeds it")
        if found.causality != "input" and found.variability != "tunable":
            its = f"{found.variability} {found.causality}"
            raise InputRefused(f"{name} is a {its}; inputs and tunable parameters can be set now")
        component.instance.write([(found, setting_value(component.instance.description.path, found, value))])

    def observe(self, *patterns: str) -> ObservedSeries:
        """Record outputs that match one of `patterns` (all without patterns) from now on, one row per completed tick.

        InputRefused if a pattern matches no output.
        """
        _, made, _ = self._running_parts()
        outputs = [
            f"{component.name}.{port.name}" for component in made.system.components for port in component.outputs
        ]
        known = {name: made.system.columns(name) for name in outputs}
        names: dict[str, None] = {}
        for pattern in patterns or ("*",):
            found = match_names(pattern, known)
            if not found:
                raise InputRefused(f"no output is called {pattern}; {nearest(pattern, known)}")
            names |= dict.fromkeys(found)
        chosen = np.concatenate([np.arange(known[name].start, known[name].stop) for name in names])
        columns, place = {}, 0
        for name in names:
            size = known[name].stop - known[name].start
            columns[name], place = slice(place, place + size), place + size
        series = ObservedSeries(columns, made.system.tick)
        self._watched.append((series, chosen))
        return series

    def state(self) -> SystemState:
        """Save the present state, for `restore`.

        InputRefused: a component cannot save its state. ComponentFailed: an FMU refuses.
        """
        return self._running_parts()[2].state()

    def restore(self, state: SystemState | SavedState) -> None:
        """Restore a saved state; observed rows after it are replaced as the system advances again.

        InputRefused: the state is of another system. ComponentFailed: an FMU refuses.
        """
        self._running_parts()[2].restore(state)

    def close(self) -> None:
        """Free the FMUs; safe to call twice."""
        self._running = None
        self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *problem: object) -> None:
        self.close()

    def _advance(self, ticks: int) -> None:
        _, _, simulation = self._running_parts()
        while ticks > 0:
            first = simulation.next_tick
            rows = simulation.advance(ticks)
            for series, chosen in self._watched:
                series._append(first, rows[:, chosen])
            ticks -= len(rows)
            if simulation.failure:
                raise simulation.failure

    def _running_parts(self) -> tuple[SystemPlan, PreparedSystem, Simulation]:
        if self._running is None:
            additions = Additions([f"{name}={text}" for name, text in self._settings.items()], inputs=self._inputs)
            if self._system is not None:
                package, beside = read_system(self._system), SystemExtras()
                if self._order or self._wires:
                    raise InputRefused(
                        f"{self._system}: components and wires cannot be added to a system read from a file"
                    )
            else:
                if self._stop is None:
                    raise InputRefused("Cosimulation: no end is given; expected stop=SECONDS")
                entries = {f"{name}.fmu": file for name, file in self._files.items()}
                package = loose_package(Path(FORM_NAME), self._structure(), entries, FORM_NAME)
                beside = self._extras()
            plan, made = self._open.enter_context(
                open_system(package, MasterChoice(self._tick, None, self._stop, self._scheme), False, additions, beside)
            )
            self._running = plan, made, Simulation(made.system, plan.timing.ticks)
        return self._running

    def _structure(self) -> ssp.Structure:
        parts = tuple(ssp.SspComponent(name, f"{name}.fmu") for name in self._files)
        connections = tuple(
            ssp.Connection(start, end, line)
            for start, end, line in ((self._end(a), self._end(b), line) for a, b, line in self._wires)
            if start.element in self._files and end.element in self._files
        )
        return ssp.Structure(
            FORM_NAME, ssp.SspSystem(FORM_NAME, parts, connections), experiment=ssp.DefaultExperiment(stop=self._stop)
        )

    def _extras(self) -> SystemExtras:
        feeds, drains, wires = [], [], []
        for output, input, line in self._wires:
            start, end = self._end(output), self._end(input)
            inside = [one.element in self._files for one in (start, end)]
            if all(inside):
                continue
            if line != ssp.Transformation():
                raise InputRefused(
                    f"the wire from {output} to {input}: a factor or an offset is supported between FMUs only; "
                    "apply it in the Python component"
                )
            if inside[1]:
                port = self._port(start, "outputs")
                size = 1 if "[" in start.connector else port.size
                unit = "" if port.unit == "1" else port.unit
                feeds.append(Feed(end, output, f"the wire from {output} to {input}", unit, size=size))
            elif inside[0]:
                self._refuse_units(start, self._port(end, "inputs").unit, output, input)
                drains.append((start, input))
            else:
                wires.append((output, input))
        order = [*([INPUTS_TOPIC] if self._inputs else []), *self._order]
        return SystemExtras(tuple(self._others.values()), tuple(feeds), tuple(drains), tuple(wires), tuple(order))

    def _refuse_units(self, start: ssp.Endpoint, unit: str, output: str, input: str) -> None:
        """Refuse a wire to a port with another unit, as FMU outputs are passed on in the FMU's own unit."""
        variable = described(self._files[start.element]).variables.get(start.connector)
        if variable is not None and unit not in ("1", variable.unit):
            raise InputRefused(
                f"the wire from {output} in '{variable.unit}' to {input} in '{unit}'; a component in Python gets what "
                "the FMU gives: declare that unit"
            )

    def _end(self, name: str) -> ssp.Endpoint:
        component, _, variable = name.partition(".")
        if component not in self._order or not variable:
            raise InputRefused(f"'{name}': no such component; {nearest(component, self._order)}")
        return ssp.Endpoint(component, variable)

    def _port(self, end: ssp.Endpoint, side: str) -> Any:
        match = _PORT_PATTERN.fullmatch(end.connector)
        ports = {port.name: port for port in getattr(self._others[end.element], side)}
        name = match["name"] if match else end.connector
        if name not in ports:
            raise InputRefused(f"{end.element} has no '{name}' among its {side}; {nearest(name, ports)}")
        return ports[name]

    def _place(self, name: str) -> tuple[Component, str]:
        plan, made, _ = self._running_parts()
        called = {part.path: part.name for part in plan.parts} | {one.name: one.name for one in plan.extras.components}
        path = max((path for path in called if name.startswith(f"{path}.")), key=len, default="")
        if not path:
            raise InputRefused(f"'{name}': no such component; {nearest(name.partition('.')[0], called)}")
        component = next(one for one in made.system.components if one.name == called[path])
        return component, name.removeprefix(f"{path}.")

    def _variable(self, component: FmuComponent, name: str) -> Variable:
        variables = component.instance.description.variables
        if name not in variables:
            raise InputRefused(f"{component.name} has no variable '{name}'; {nearest(name, variables)}")
        return variables[name]

    def _register_name(self, name: str) -> None:
        self._refuse_running("components")
        if not FIELD_NAME.fullmatch(name) or name in (EVENTS_TOPIC, INPUTS_TOPIC):
            raise InputRefused(
                f"'{name}': expected a name of letters, digits and _, and not {EVENTS_TOPIC} or {INPUTS_TOPIC}"
            )
        if name in self._order:
            raise InputRefused(f"two components are called '{name}'; give each a name of its own")
        self._order.append(name)

    def _refuse_running(self, what: str) -> None:
        if self._running is not None:
            raise InputRefused(f"the system runs already; give it its {what} before the first step")
