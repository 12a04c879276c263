"""An FMU of any kind as a component: initialised, brought into step mode, stepped by address.

Each is made anew for each run. FMI's `reset` is used by nothing but a check of it: it begins again, and brings no state
back.
"""

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from twin.kernel.compiled.function import carray
from twin.kernel.cosim.component import Component, Holder, Rewind, address_of, doubles_at, step_function
from twin.kernel.cosim.port import by_port
from twin.kernel.cosim.python_class import STEP, ObjectStates
from twin.kernel.errors import ComponentFailed, InputRefused, TwinError
from twin.kernel.fmi.cosim_step import SHORTER
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.groups import MOST_UPDATES, get_all
from twin.kernel.fmi.lifecycle import CosimInstance, Fmi2, Fmi3, FMU2Exchange, FMU3Exchange
from twin.kernel.fmi.solvers import (
    FUNCTIONS,
    FUNCTIONS_3,
    GUARD,
    MANY_EVENTS,
    MEMORY,
    MOST_EVENTS,
    OVERFLOW,
    UNTOUCHED,
    USUAL_TOLERANCE,
    Cvode,
    Solver,
    brought,
    handled,
    integrate_cvode,
    integrate_rk4,
    sentence,
    slack,
    weigh,
)
from twin.kernel.fmi.state import FmuStates, RememberedMessages, is_distrusted
from twin.kernel.fmi.stepping import FmuPort, Instance, Placed, Stepping, placed
from twin.kernel.fmi.variable import Setting, Setup, Variable


@step_function(MEMORY)
def step(m, t, h, u, y):
    end = t + h
    jumped = m.fresh != 0
    m.fresh = 0
    given, last = carray(u, m.width), carray(doubles_at(m.last_inputs), m.width)
    for j in range(m.width):
        if given[j] != last[j]:
            last[j] = given[j]
            jumped = True
    # a step that may be repeated has to begin as it will the next time
    if m.final == 0:
        m.restart = 1
    events = 0
    if m.now < m.next_event <= m.now + slack(m.now):
        # the same time, but an FMU may compare
        m.now = m.next_event
        status = brought(m, m.now, m.x)
        if status != 0:
            return status
    if jumped or m.next_event <= m.now:
        status = handled(m, address_of(u), jumped)
        if status != 0:
            return status
    while m.now < end - slack(end):
        happened = m.next_event <= m.now
        if not happened:
            stop = min(end, m.next_event)
            if m.cvode != 0:
                happened, status = integrate_cvode(m, stop)
            else:
                happened, status = integrate_rk4(m, stop)
            if status != 0:
                return status
        if happened:
            events += 1
            if events > MOST_EVENTS:
                return MANY_EVENTS
            status = handled(m, address_of(u), False)
            if status != 0:
                return status
    for array, count in ((m.x, m.size), (m.k_1, m.size), (m.z, m.indicators)):
        if carray(doubles_at(array), count + 1)[count] != UNTOUCHED:
            return OVERFLOW
    return get_all(m.version, m.instance, m.output_groups, m.outputs, address_of(y))


class Integrator:
    """What steps one instance.

    Args:
        model: the instance, in continuous-time mode.
        solver: which.
        tables: of `groups.GROUP`, inputs and outputs; none: they are set and read by somebody else.
        width: number of inputs.

    Attributes:
        memory: (1,) of `MEMORY`.
        block: all that a step changes of this memory, to be saved and brought back as bytes.

    Raises:
        InputRefused: there is no CVODE for this platform.
    """

    def __init__(
        self,
        model: "ModelExchange",
        solver: Solver = Solver(),  # noqa: B008, it is frozen
        tables: Sequence[np.ndarray] = (),
        width: int = 0,
    ):
        self._model, size = model, max(model.states, 1)
        tolerance = model.setup.tolerance or USUAL_TOLERANCE
        rows = {"x": size, "z_before": model.indicators, "last_inputs": width}
        scratch = {name: size for name in ("began", "k_1", "k_2", "k_3", "k_4", "scales")}
        scratch |= {"z": model.indicators, "info": GUARD}
        self.block, begins = _laid_out(rows, MEMORY.itemsize // 8)
        self._scratch, places = _laid_out(scratch)
        self.memory = self.block[: MEMORY.itemsize // 8].view(MEMORY)
        self._rows = {name: self.block[begins[name] :][:count] for name, count in rows.items()}
        m = self.memory[0]
        for name, place in begins.items():
            m[name] = self.block.ctypes.data + 8 * place
        for name, place in places.items():
            m[name] = self._scratch.ctypes.data + 8 * place
        version = model.description.version
        for field, function in (FUNCTIONS if version == 2 else FUNCTIONS_3).items():
            if version == 3 or field != "number_of_states":
                m[field] = model.address(function)
        m["version"], m["instance"] = version, model.handle
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
        m["next_event"] = model.next_event
        m["reached_at"] = self.memory["reached"].ctypes.data
        x = self.block[begins["x"] :][:size]
        scales = self._scratch[places["scales"] :][:size]
        x[:] = scales[:] = 1.0
        scales[: model.states] = model.nominals()
        weigh(scales, tolerance)
        self._cvode = None
        if solver.method == "cvode":
            self._cvode = Cvode(x, scales, tolerance, model.indicators, self.memory.ctypes.data)
            for field, address in self._cvode.addresses.items():
                m[field] = address

    def pieces(self) -> dict[str, np.ndarray]:
        """What of its memory steps change, by name; nothing of it is an address."""
        return {name: self.memory[name] for name in ("fresh", "now", "next_event")} | self._rows

    def advance(self, t: float, h: float) -> int:
        """One step from `t` to `t` + `h` (s), inputs as somebody has set them; 0 or a bad status."""
        self.memory[0]["fresh"] = 1
        nothing = np.zeros(1)
        place = nothing.ctypes.data
        return int(STEP(step.address)(self.memory.ctypes.data, t, h, place, place))

    def explain(self, status: int) -> str:
        """What a bad `status` of the step means, as the verb phrase of a sentence; "" if it is none of its own."""
        return sentence(self.memory[0], status)

    def close(self) -> None:
        """Free the solver; safe to call twice."""
        if self._cvode is not None:
            self._cvode.close()
            self._cvode = None


def _laid_out(sizes: dict[str, int], first: int = 0) -> tuple[np.ndarray, dict[str, int]]:
    """One array for all, each with a guard behind it, after `first` numbers for something else; where each begins."""
    places, place = {}, first
    for name, size in sizes.items():
        places[name] = place
        place += size + GUARD
    block = np.full(place, UNTOUCHED)
    block[:first] = 0.0
    for name, size in sizes.items():
        block[places[name] : places[name] + size] = 0.0
    return block, places


MOST_STATES, MOST_INDICATORS = 1000, 10_000
"""A dense Jacobian of more states than that is not what a drive is made of."""


class _Fmi3(Fmi3):
    """Which has another function for each kind to make an instance."""

    def __init__(self) -> None:
        super().__init__(FMU3Exchange)

    def instantiate(self, instance: Instance) -> None:
        with instance.calling("InstantiateModelExchange"):
            instance.fmu.instantiate(logMessage=lambda environment, status, category, text: instance.hear(status, text))


class ModelExchange(Instance):
    """An FMU instance of the kind model exchange; arguments, errors and attributes as those of `Instance`.

    Attributes:
        states, indicators: how many it has.
        next_event: time event that it asked for at its start (s), infinity if none.
    """

    _standards: ClassVar[Mapping[int, Any]] = {2: Fmi2(FMU2Exchange), 3: _Fmi3()}
    _integrator: Integrator | None = None

    def ramps(self, variable: Variable) -> bool:
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
        # what integrates it where no component does; `advance` begins its history anew
        return [*super().schedule, *([self._integrator.block] if self._integrator else [])]

    def close(self) -> None:
        self._forget_integrator()
        super().close()

    def nominals(self) -> np.ndarray:
        """Nominal values of its states, (states,)."""
        return self._numbers("NominalsOfContinuousStates", self.states)

    def _initialise(self) -> None:
        self._forget_integrator()
        super()._initialise()
        path, version = self.description.path, self.description.version
        update = self.fmu.newDiscreteStates if version == 2 else self.fmu.updateDiscreteStates
        try:
            with self.calling("NewDiscreteStates" if version == 2 else "UpdateDiscreteStates"):
                for _ in range(MOST_UPDATES):
                    needed, ended, _, _, timed, when = update()
                    if ended or not needed:
                        break
            if not ended and not needed:
                with self.calling("EnterContinuousTimeMode"):
                    self.fmu.enterContinuousTimeMode()
        # FMPy's FMICallException
        except Exception as problem:
            self.close()
            raise InputRefused(
                f"{path}: cannot be brought into continuous-time mode: {problem}{self._quoted_messages()}"
            ) from None
        try:
            if ended or needed:
                why = "it asks to terminate" if ended else f"its first event needs more than {MOST_UPDATES} updates"
                raise InputRefused(
                    f"{path}: cannot be brought into continuous-time mode: {why}{self._quoted_messages()}"
                )
            self.next_event = when if timed else np.inf
            if not self.next_event >= 0.0:
                raise InputRefused(f"{path}: asks for a time event at {when:g} s, before the start")
            self._measure()
        except InputRefused:
            self.close()
            raise

    def _measure(self) -> None:
        """Numbers of states and indicators, and whether it keeps to them.

        Raises:
            InputRefused: it does not, there are too many, or some are not finite.
        """
        model = self.description.model
        self.states, self.indicators = model.numberOfContinuousStates, model.numberOfEventIndicators
        if self.description.version == 3:
            with self.calling("GetNumberOfContinuousStates"):
                self.states = self.fmu.getNumberOfContinuousStates()
            with self.calling("GetNumberOfEventIndicators"):
                self.indicators = self.fmu.getNumberOfEventIndicators()
        resized = any(v.causality == "structuralParameter" for v in self.description.variables.values())
        for count, listed, most, name in (
            (self.states, model.numberOfContinuousStates, MOST_STATES, "continuous states"),
            (self.indicators, model.numberOfEventIndicators, MOST_INDICATORS, "event indicators"),
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
        """What its function `Get{name}` says, (count,)."""
        if count == 0:
            return np.zeros(0)
        values = np.full(count + GUARD, UNTOUCHED)
        function = f"fmi{self.description.version}Get{name}"
        try:
            with self.calling(f"Get{name}"):
                pointer = values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
                getattr(self.fmu, f"get{name}")(pointer, count)
        # FMPy's FMICallException
        except Exception as problem:
            raise InputRefused(
                f"{self.description.path}: {function} failed: {problem}{self._quoted_messages()}"
            ) from None
        if np.any(values[count:] != UNTOUCHED) or np.any(values[:count] == UNTOUCHED):
            other = "more" if np.any(values[count:] != UNTOUCHED) else "fewer"
            raise InputRefused(
                f"{self.description.path}: {function} writes {other} numbers than the {count} that "
                "modelDescription.xml lists; export it again"
            )
        return values[:count]

    def _forget_integrator(self) -> None:
        if self._integrator is not None:
            self._integrator.close()
        self._integrator = None


def opened(
    name: str,
    description: FmuDescription,
    folder: Path,
    settings: Sequence[Setting] = (),
    inputs: Sequence[Setting] = (),
    setup: Setup = Setup(),  # noqa: B008, it is frozen
) -> Instance:
    """A new instance; arguments as those of `Instance`.

    Raises:
        InputRefused: it cannot be loaded, instantiated or initialised.
    """
    kind = ModelExchange if description.kind == "model_exchange" else CosimInstance
    return kind(name, description, folder, settings, inputs, setup)


class _Left:
    """Whether instances are left as they are now, and those that were."""

    def __init__(self) -> None:
        self.now = False
        self.instances: list[Instance] = []


_left = _Left()


@contextmanager
def instances_left() -> Iterator[None]:
    """Within the block none is freed, unless its FMU can live only once in a process: some crash then."""
    _left.now = True
    try:
        yield
    finally:
        _left.now = False


def release(instance: Instance) -> None:
    """Its run is over: free it, but not within `instances_left`."""
    if _left.now and not instance.description.lives_once:
        _left.instances.append(instance)
    else:
        instance.close()


class FmuComponent(Component):
    """One FMU instance as a component, a continuous one if nothing else is said; for model exchange with its solver.

    Args:
        name: of the component and the FMU instance.
        description: the checked FMU.
        folder: where it is unpacked.
        inputs, outputs: its ports.
        settings: values set before initialisation, in the FMU's own units.
        inputs_at_start: port -> value (SI) in initialisation mode; 0 where nothing is said.
        outputs_at_start: port -> value (SI) that the output is taken to have at t = 0: an angle's zero is arbitrary,
            and the shaft is coupled where it stands.
        setup: of the run.
        sampled: whether it is evaluated at t_k; its outputs mean nothing before the first time then.
        instance: of the FMU, in step mode; None: one is made, and initialised with what is said here.
        solver: of the equations of one for model exchange; None: CVODE.

    Raises:
        InputRefused: the FMU cannot be brought into step mode, or an output is not finite then; there is no CVODE for
            this platform.
    """

    def __init__(
        self,
        name: str,
        description: FmuDescription,
        folder: Path,
        inputs: Sequence[FmuPort],
        outputs: Sequence[FmuPort],
        settings: Sequence[Setting] = (),
        inputs_at_start: Mapping[str, float | np.ndarray] | None = None,
        outputs_at_start: Mapping[str, float | np.ndarray] | None = None,
        setup: Setup = Setup(),  # noqa: B008, it is frozen
        sampled: bool = False,
        instance: Instance | None = None,
        solver: Solver | None = None,
    ):
        wanted = inputs_at_start or {}
        started = [(p.variable, p.in_fmu(wanted.get(p.port.name, 0.0))) for p in inputs]
        make = CosimInstance if sampled else opened
        self.instance = instance or make(name, description, folder, settings, started, setup)
        initial = np.concatenate([p.gain * self._raw(p) + p.offset for p in outputs]) if outputs else np.zeros(0)
        if sampled:
            initial[:] = 0.0
        # what -0.0 is added to stays what it is
        shift = np.full(len(initial), -0.0)
        for p in placed(outputs):
            if p.port.port.name in (outputs_at_start or {}):
                shift[p.slots] = (outputs_at_start or {})[p.port.port.name] - initial[p.slots]
        if not np.all(np.isfinite(initial)):
            self.instance.close()
            raise InputRefused(f"{description.path}: an output is not finite after initialisation: {initial}")
        self._shift = shift
        try:
            self._stepping = (
                ExchangeStepping(self.instance, solver or Solver(), inputs, outputs, shift)
                if isinstance(self.instance, ModelExchange)
                else Stepping(self.instance, inputs, outputs, shift)
            )
        except TwinError:
            self.instance.close()
            raise
        self._rewind: Rewind | None = None
        self._inside = FmuStates(self.instance, self._stepping)
        self._remembered = ObjectStates(description.path.name, RememberedMessages(self.instance, self._stepping))
        super().__init__(
            name=name,
            inputs=tuple(p.port for p in self._stepping.inputs),
            outputs=tuple(p.port for p in outputs),
            sampled=sampled,
            step_address=self._stepping.address,
            self_address=self._stepping.memory.ctypes.data,
            initial_outputs=initial + shift,
            label=description.path.name,
            keep=self._stepping.memory,
        )

    def zero(self, name: str) -> float:
        """Value of the output port `name` where the FMU's own is 0."""
        return float(by_port(self.outputs, self._shift)[name][0])

    @property
    def ports(self) -> tuple[Sequence[FmuPort], Sequence[Placed]]:
        """What of the FMU is behind its inputs and its outputs."""
        return self._stepping.inputs, self._stepping.outputs

    @property
    def called(self) -> str:
        """What of the FMU its step calls, for people."""
        if isinstance(self.instance, ModelExchange):
            return "its equations of model exchange"
        return f"{self.instance.description.prefix}DoStep"

    def _raw(self, port: FmuPort) -> np.ndarray:
        """Values of an output before the first step; what a clock updates cannot be read before that ticks."""
        if port.variable.clocks:
            return np.full(port.port.size, np.nan_to_num(port.variable.start))
        return self.instance.read([port.variable])

    def explain(self, status: int) -> str:
        return self._stepping.explain(status)

    def rewind(self) -> Rewind | None:
        if not self.instance.description.interface.canGetAndSetFMUstate:
            return None
        if self._rewind is None:
            save, restore, memory = self._stepping.repeatable()
            self._rewind = Rewind(save, restore, memory.ctypes.data, memory)
        return self._rewind

    def pieces(self) -> dict[str, np.ndarray]:
        return self._stepping.pieces()

    def holders(self) -> dict[str, Holder]:
        return {"fmu": self._inside, "messages": self._remembered}

    def lacks_state(self, portable: bool = True) -> str:
        interface, version = self.instance.description.interface, self.instance.description.version
        if not interface.canGetAndSetFMUstate:
            return "has no FMU state" + (" (FMI 1.0 knows none)" if version == 1 else " (canGetAndSetFMUState)")
        if is_distrusted(self.instance.description.sha256):
            return "goes on differently from a state that it saved, as twin drive check found"
        if portable and not interface.canSerializeFMUstate:
            return "cannot write its FMU state down (canSerializeFMUState)"
        if isinstance(self._stepping, ExchangeStepping) and self._stepping.solver.method == "cvode":
            return 'is solved by CVODE, whose history cannot be saved; solver = "rk4" has none'
        return ""

    def keep_time(self, clock: np.ndarray) -> None:
        self.instance.clock = clock

    def take_messages(self) -> list[tuple[int, str]]:
        messages = self.instance.unheard()
        since = self._stepping.discarded_since
        if since is not None and not self._stepping.discard_reported:
            self._stepping.discard_reported = True
            text = f"it discards steps, which are then made in parts, since t = {since:g} s"
            messages.append((int(self.instance.clock[0]), text))
        return messages

    def close(self) -> None:
        if isinstance(self._stepping, ExchangeStepping):
            self._stepping.integrator.close()
        rewind, self._rewind = self._rewind, None
        self._inside.close()
        try:
            if rewind is not None and rewind.keep[0]["state"]:
                self.instance.forget(int(rewind.keep[0]["state"]))
        finally:
            if self.sampled:
                self.instance.close()
            else:
                release(self.instance)


class ExchangeStepping(Stepping):
    """How a model-exchange FMU is stepped.

    Args:
        instance: in continuous-time mode.
        solver: of its equations.
        inputs, outputs, shift: as those of `Stepping`.

    Attributes:
        integrator: what the step works on.
        solver: the argument.

    Raises:
        InputRefused: there is no CVODE for this platform.
    """

    def __init__(
        self,
        instance: ModelExchange,
        solver: Solver,
        inputs: Sequence[FmuPort],
        outputs: Sequence[FmuPort],
        shift: np.ndarray,
    ):
        self.instance, self.inputs = instance, list(inputs)
        self._keep: list[Any] = []
        self._moving: list[np.ndarray] = []
        self._shorter = np.zeros(1, dtype=SHORTER)
        tables = self._grouped(placed(inputs), "Set"), self._grouped(placed(outputs, shift), "Get")
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
