"""Model-exchange FMUs: continuous-time mode, and steps that integrate their equations by address."""

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from twin.kernel.compiled.function import carray, njit
from twin.kernel.cosim.component import address_of, doubles_at, step_function
from twin.kernel.cosim.python_class import STEP_FUNCTION
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi import solvers
from twin.kernel.fmi.cosim_step import DISCARD_RECORD
from twin.kernel.fmi.groups import MAX_UPDATES, get_all, set_all, store_status
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.lifecycle import Fmi2, Fmi3, FMU2Exchange, FMU3Exchange
from twin.kernel.fmi.stepping import FmuPort, Stepping, port_slots
from twin.kernel.fmi.variable import Variable

MAX_STATES, MAX_INDICATORS = 1000, 10_000
"""Maximum numbers of continuous states and event indicators; the Jacobian of the solver is dense."""


@step_function(solvers.SOLVER_MEMORY)
def step(m, t, h, u, y):
    return store_status(m.note, _step(m, t, h, u, y))


@njit(cache=True, inline="always")
def _step(m, t, h, u, y):
    end = t + h
    jumped = m.fresh != 0
    m.fresh = 0
    given, last = carray(u, m.width), carray(doubles_at(m.last_inputs), m.width)
    for j in range(m.width):
        if given[j] != last[j]:
            last[j] = given[j]
            jumped = True
    # a step that may be repeated has to begin in the same way each time
    if m.final == 0:
        m.restart = 1
    events = 0
    if m.now < m.next_event <= m.now + solvers.time_tolerance(m.now):
        # advance to the exact event time, as an FMU may compare times
        m.now = m.next_event
        status = solvers.set_time_and_states(m, m.now, m.x)
        if status != 0:
            return status
    if jumped or m.next_event <= m.now:
        status = solvers.handle_event(m, address_of(u), jumped)
        if status != 0:
            return status
    while m.now < end - solvers.time_tolerance(end):
        happened = m.next_event <= m.now
        if not happened:
            stop = min(end, m.next_event)
            if m.cvode != 0:
                happened, status = solvers.integrate_cvode(m, stop)
            else:
                happened, status = solvers.integrate_rk4(m, stop)
            if status != 0:
                return status
        if happened:
            events += 1
            if events > solvers.MAX_EVENTS:
                return solvers.TOO_MANY_EVENTS
            status = solvers.handle_event(m, address_of(u), False)
            if status != 0:
                return status
    for array, count in ((m.x, m.size), (m.k_1, m.size), (m.z, m.indicators)):
        if carray(doubles_at(array), count + 1)[count] != solvers.GUARD_VALUE:
            return solvers.ARRAY_OVERFLOW
    return get_all(m.version, m.instance, m.output_groups, m.outputs, address_of(y))


@step_function(solvers.SOLVER_MEMORY)
def react(m, t, h, u, y):
    """Compute a model-exchange FMU's outputs for other inputs at the present time, without a step."""
    status = set_all(m.version, m.instance, m.input_groups, m.inputs, address_of(u))
    if status == 0:
        # the next step sets its inputs again, and handles a jump as an event
        m.fresh = 1
        status = get_all(m.version, m.instance, m.output_groups, m.outputs, address_of(y))
    return store_status(m.note, status)


class Integrator:
    """Solver of a model-exchange FMU's equations, with the memory of its compiled step.

    The model is in continuous-time mode and has `width` input values. `tables` are `groups.GROUP_RECORD` of inputs and
    outputs, empty if the caller sets and reads them. `memory` is (1,) of `SOLVER_MEMORY`. `block` is contiguous memory
    that steps change, to be saved and restored as bytes.
    """

    def __init__(
        self,
        model: "ModelExchange",
        solver: solvers.Solver = solvers.Solver(),  # noqa: B008, it is frozen
        tables: Sequence[np.ndarray] = (),
        width: int = 0,
    ):
        self._model, size = model, max(model.states, 1)
        tolerance = model.setup.tolerance or solvers.DEFAULT_TOLERANCE
        rows = {"x": size, "z_before": model.indicators, "last_inputs": width}
        scratch = {name: size for name in ("began", "k_1", "k_2", "k_3", "k_4", "scales")}
        scratch |= {"z": model.indicators, "info": solvers.GUARD_SIZE}
        self.block, begins = _allocate_block(rows, solvers.SOLVER_MEMORY.itemsize // 8)
        self._scratch, places = _allocate_block(scratch)
        self.memory = self.block[: solvers.SOLVER_MEMORY.itemsize // 8].view(solvers.SOLVER_MEMORY)
        self._rows = {name: self.block[begins[name] :][:count] for name, count in rows.items()}
        m = self.memory[0]
        for name, place in begins.items():
            m[name] = self.block.ctypes.data + 8 * place
        for name, place in places.items():
            m[name] = self._scratch.ctypes.data + 8 * place
        version = model.description.version
        for field, function in (solvers.EXCHANGE_FUNCTIONS if version == 2 else solvers.EXCHANGE_FUNCTIONS_3).items():
            if version == 3 or field != "number_of_states":
                m[field] = model.address(function)
        m["version"], m["instance"], m["note"] = version, model.handle, model.note.ctypes.data
        m["states"], m["size"], m["indicators"], m["width"] = model.states, size, model.indicators, width
        interface = model.description.interface
        skipped = (
            interface.completedIntegratorStepNotNeeded if version == 2 else not interface.needsCompletedIntegratorStep
        )
        m["needs_completed"], m["final"] = not skipped, 1
        for side, table in zip(("input", "output"), tables, strict=False):
            m[f"{side}s"], m[f"{side}_groups"] = len(table), table.ctypes.data
        m["fresh"] = m["restart"] = 1
        m["tolerance"], m["longest"] = tolerance, solver.step or 0.0
        m["now"], m["next_event"] = model.setup.start, model.next_event
        m["reached_at"] = self.memory["reached"].ctypes.data
        x = self.block[begins["x"] :][:size]
        scales = self._scratch[places["scales"] :][:size]
        x[:] = scales[:] = 1.0
        scales[: model.states] = model.nominals()
        solvers.scale_tolerances(scales, tolerance)
        self._cvode = None
        if solver.method == "cvode":
            self._cvode = solvers.Cvode(x, scales, tolerance, model.indicators, self.memory.ctypes.data)
            for field, address in self._cvode.addresses.items():
                m[field] = address

    def pieces(self) -> dict[str, np.ndarray]:
        """Return the parts of the integrator's memory that steps change, by name; excludes addresses."""
        return {name: self.memory[name] for name in ("fresh", "now", "next_event")} | self._rows

    def advance(self, t: float, h: float) -> int:
        """Integrate the equations from `t` to `t` + `h` (s), inputs set by the caller; return 0 or a failure status."""
        self.memory[0]["fresh"] = 1
        nothing = np.zeros(1)
        place = nothing.ctypes.data
        return int(STEP_FUNCTION(step.address)(self.memory.ctypes.data, t, h, place, place))

    def explain(self, status: int) -> str:
        """Describe a failure status of a model-exchange step as a verb phrase; "" for statuses of other origin."""
        return solvers.exchange_error(self.memory[0], status, self._model.invalid_status)

    def close(self) -> None:
        """Free the solver of the FMU's equations; safe to call twice."""
        if self._cvode is not None:
            self._cvode.close()


def _allocate_block(sizes: dict[str, int], first: int = 0) -> tuple[np.ndarray, dict[str, int]]:
    """Allocate named arrays, each with a guard behind it, after `first` other numbers; return (block, offsets)."""
    places, place = {}, first
    for name, size in sizes.items():
        places[name] = place
        place += size + solvers.GUARD_SIZE
    block = np.full(place, solvers.GUARD_VALUE)
    block[:first] = 0.0
    for name, size in sizes.items():
        block[places[name] : places[name] + size] = 0.0
    return block, places


class _Fmi3(Fmi3):
    """Life cycle of an FMI 3.0 FMU for model exchange, which has its own function for instantiation."""

    def instantiate(self, instance: Instance) -> None:
        with instance.calling("InstantiateModelExchange"):
            instance.fmu.instantiate(
                logMessage=lambda environment, status, category, text: instance.on_message(status, text)
            )


class ModelExchange(Instance):
    """An FMU instance for model exchange, with numbers of states and event indicators; else as `Instance`.

    `next_event` is the time event requested at the start (s); infinity without one.
    """

    _standards: ClassVar[Mapping[int, Any]] = {2: Fmi2(FMU2Exchange), 3: _Fmi3(FMU3Exchange)}
    _integrator: Integrator | None = None

    def takes_ramp(self, variable: Variable) -> bool:
        return False

    def advance(self, t: float, h: float) -> None:
        if self._integrator is None:
            self._integrator = Integrator(self)
        status = self._integrator.advance(t, h)
        if status:
            name = self.description.path.name
            raise ComponentFailed(f"{name}: {self._integrator.explain(status)}{self._quoted_messages()}")

    @property
    def schedule(self) -> list[np.ndarray]:
        # memory of an integrator without component; `advance` restarts its history
        return [*super().schedule, *([self._integrator.block] if self._integrator else [])]

    def close(self) -> None:
        self._close_integrator()
        super().close()

    def nominals(self) -> np.ndarray:
        """Return the nominal values of the FMU's continuous states, (states,)."""
        return self._numbers("NominalsOfContinuousStates", self.states)

    def begin(self) -> None:
        super().begin()
        self._to_continuous_time()

    def _initialise(self) -> None:
        self._close_integrator()
        super()._initialise()
        self._to_continuous_time()

    def _to_continuous_time(self) -> None:
        path, version = self.description.path, self.description.version
        update = self.fmu.newDiscreteStates if version == 2 else self.fmu.updateDiscreteStates
        why = ""
        try:
            with self.calling("NewDiscreteStates" if version == 2 else "UpdateDiscreteStates"):
                for _ in range(MAX_UPDATES):
                    needed, ended, _, _, timed, when = update()
                    if ended or not needed:
                        break
            if ended or needed:
                why = "it asks to terminate" if ended else f"its first event needs more than {MAX_UPDATES} updates"
            else:
                self.call("EnterContinuousTimeMode")
        # FMICallException of FMPy
        except Exception as problem:
            why = str(problem) or type(problem).__name__
        try:
            if why:
                raise InputRefused(
                    f"{path}: cannot be brought into continuous-time mode: {why}{self._quoted_messages()}"
                )
            self.next_event = when if timed else np.inf
            if not self.next_event >= self.setup.start:
                raise InputRefused(f"{path}: asks for a time event at {when:g} s, before the start")
            self._measure()
        except InputRefused:
            self.close()
            raise

    def _measure(self) -> None:
        """Query the FMU's numbers of states and event indicators; refuse wrong or too large ones, and NaN."""
        model = self.description.model
        self.states, self.indicators = model.numberOfContinuousStates, model.numberOfEventIndicators
        if self.description.version == 3:
            self.states = self.call("GetNumberOfContinuousStates")
            self.indicators = self.call("GetNumberOfEventIndicators")
        resized = any(v.causality == "structuralParameter" for v in self.description.variables.values())
        for count, listed, most, name in (
            (self.states, model.numberOfContinuousStates, MAX_STATES, "continuous states"),
            (self.indicators, model.numberOfEventIndicators, MAX_INDICATORS, "event indicators"),
        ):
            if count > most:
                raise InputRefused(f"{self.description.path}: {count} {name}; a drive may have {most}")
            if count != listed and not resized:
                raise InputRefused(
                    f"{self.description.path}: its binary has {count} {name}, its modelDescription.xml lists {listed}; "
                    "export it again"
                )
        derivatives = "Derivatives" if self.description.version == 2 else "ContinuousStateDerivatives"
        for name, count in (
            ("ContinuousStates", self.states),
            (derivatives, self.states),
            ("NominalsOfContinuousStates", self.states),
            ("EventIndicators", self.indicators),
        ):
            values = self._numbers(name, count)
            if not np.all(np.isfinite(values)):
                bad = int(np.flatnonzero(~np.isfinite(values))[0])
                raise InputRefused(
                    f"{self.description.path}: fmi{self.description.version}Get{name} says {values[bad]} for number "
                    f"{bad + 1} of {count} at the start; expected finite numbers"
                )

    def _numbers(self, name: str, count: int) -> np.ndarray:
        """Read a vector of `count` doubles with the FMU's function `Get{name}`; refuse more or fewer (guard values)."""
        if count == 0:
            return np.zeros(0)
        values = np.full(count + solvers.GUARD_SIZE, solvers.GUARD_VALUE)
        path, function = self.description.path, f"fmi{self.description.version}Get{name}"
        try:
            with self.calling(f"Get{name}"):
                pointer = values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
                getattr(self.fmu, f"get{name}")(pointer, count)
        # FMICallException of FMPy
        except Exception as problem:
            raise InputRefused(f"{path}: {function} failed: {problem}{self._quoted_messages()}") from None
        if np.any(values[count:] != solvers.GUARD_VALUE) or np.any(values[:count] == solvers.GUARD_VALUE):
            other = "more" if np.any(values[count:] != solvers.GUARD_VALUE) else "fewer"
            raise InputRefused(
                f"{path}: {function} writes {other} numbers than the {count} that "
                "modelDescription.xml lists; export it again"
            )
        return values[:count]

    def _close_integrator(self) -> None:
        if self._integrator is not None:
            self._integrator.close()
        self._integrator = None


class ExchangeStepping(Stepping):
    """Compiled step of a model-exchange FMU instance, which integrates its equations; arguments as of `Stepping`."""

    def __init__(
        self,
        instance: ModelExchange,
        solver: solvers.Solver,
        inputs: Sequence[FmuPort],
        outputs: Sequence[FmuPort],
        shift: np.ndarray,
    ):
        self.instance, self.inputs, self.outputs = instance, list(inputs), port_slots(outputs, shift)
        self._keep: list[Any] = []
        self._moving: list[np.ndarray] = []
        self._shorter = np.zeros(1, dtype=DISCARD_RECORD)
        self._into = port_slots(inputs)
        tables = self._group_table(self._into, "Set"), self._group_table(self.outputs, "Get")
        self.solver = solver
        self.integrator = Integrator(instance, solver, tables, sum(p.port.size for p in inputs))
        self._moving.append(self.integrator.block)
        self.address, self.memory = step.address, self.integrator.memory

    def pieces(self) -> dict[str, np.ndarray]:
        return self.integrator.pieces()

    def explain(self, status: int) -> str:
        reason = self.integrator.explain(status)
        text = f" ('{self.instance.messages[-1]}')" if self.instance.messages else ""
        return f"{reason}{text}" if reason else super().explain(status)
