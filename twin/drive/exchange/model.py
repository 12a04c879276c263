"""An FMU instance in continuous-time mode, brought there by FMPy."""

import ctypes
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from twin.drive.exchange.integrator import Integrator
from twin.drive.exchange.memory import GUARD, UNTOUCHED
from twin.drive.instance import Instance
from twin.drive.slave import FMU2Exchange, FMU3Exchange
from twin.drive.standards import fmi2, fmi3
from twin.drive.status import MOST_UPDATES
from twin.drive.variable import Variable
from twin.errors import ComponentFailed, InputRefused

MOST_STATES, MOST_INDICATORS = 1000, 10_000
"""A dense Jacobian of more states than that is not what a drive is made of."""


def _instantiate_3(instance: Instance) -> None:
    """Make the FMU's own instance of FMI 3.0, which has another function for each kind; it is NULL if it refuses."""
    with instance.calling("InstantiateModelExchange"):
        instance.fmu.instantiate(logMessage=lambda environment, status, category, said: instance.hear(status, said))


class Model(Instance):
    """An FMU instance of the kind model exchange; arguments, errors and attributes as those of `Instance`.

    Attributes:
        states, indicators: how many it has.
        next_event: time event that it asked for at its start (s), infinity if none.
    """

    _standards: ClassVar[Mapping[int, Any]] = {
        2: SimpleNamespace(**vars(fmi2) | {"SLAVE": FMU2Exchange}),
        3: SimpleNamespace(**vars(fmi3) | {"SLAVE": FMU3Exchange, "instantiate": _instantiate_3}),
    }
    _integrator: Integrator | None = None

    def ramps(self, variable: Variable) -> bool:
        return False

    def advance(self, t: float, h: float) -> None:
        if self._integrator is None:
            self._integrator = Integrator(self)
        status = self._integrator.advance(t, h)
        if status:
            name = self.description.path.name
            raise ComponentFailed(f"{name}: {self._integrator.explain(status)}{self._said()}")

    def saved_state(self) -> Any:
        return super().saved_state(), self._integrator.kept() if self._integrator else None

    def restore(self, state: Any) -> None:
        inside, kept = state
        super().restore(inside)
        if self._integrator is not None and kept is not None:
            self._integrator.take(kept)

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
                f"{path}: cannot be brought into continuous-time mode: {problem}{self._said()}"
            ) from None
        try:
            if ended or needed:
                why = "it asks to terminate" if ended else f"its first event needs more than {MOST_UPDATES} updates"
                raise InputRefused(f"{path}: cannot be brought into continuous-time mode: {why}{self._said()}")
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
            raise InputRefused(f"{self.description.path}: {function} failed: {problem}{self._said()}") from None
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
