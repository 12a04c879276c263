"""Choices of the master of a system: step, times, coupling, kinds and order of its FMUs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from twin.kernel.errors import InputRefused, nearest

if TYPE_CHECKING:
    from twin.kernel.cosim.interpolation import Scheme
    from twin.kernel.fmi.description import FmuDescription, Kind

Loops = Literal["delay", "solve"]
Method = Literal["cvode", "rk4"]
FMU_KINDS: "tuple[Kind, ...]" = ("co_simulation", "model_exchange")


@dataclass(frozen=True)
class MasterChoice:
    """What is asked of the master.

    Attributes:
        tick, start, stop: length of a step, beginning and end of the run (s); None: as the system says.
        scheme: "gauss_seidel" in the order of components, or "jacobi"; None: that of the tools that write such files.
        kinds: as which FMUs are used, by component; by "" those of which the system says nothing.
        solver: of all FMUs for model exchange; None: CVODE.
        steps: of components (s).
        order: components that go first, in this order.
        loops: what is done about algebraic loops.
        lenient: whether small offences against the standards, which are listed, are let through.
    """

    tick: float | None = None
    start: float | None = None
    stop: float | None = None
    scheme: "Scheme | None" = None
    kinds: "Mapping[str, Kind]" = field(default_factory=dict)
    solver: Method | None = None
    steps: Mapping[str, float] = field(default_factory=dict)
    order: Sequence[str] = ()
    loops: Loops = "delay"
    lenient: bool = False

    @property
    def method(self) -> Method:
        """Of the solver."""
        return self.solver or "cvode"

    def refuse_unknown(self, components: Iterable[str], where: str) -> None:
        """Refuse names that are no components of the system.

        Raises:
            InputRefused: the first of them.
        """
        known = list(components)
        for option, names in (("--kind", self.kinds), ("--step", self.steps), ("--order", self.order)):
            for name in names:
                if name and name not in known:
                    raise InputRefused(f"{where}: {option} {name}: no such component; {nearest(name, known)}")

    def refuse_idle(self, used: "Mapping[str, FmuDescription]", scheme: "Scheme", where: str) -> None:
        """Refuse what is asked of FMUs that the system does not have.

        Args:
            used: the FMU of each component, as what it is used.
            scheme: of the system.
            where: for sentences.

        Raises:
            InputRefused: a solver without equations to solve, a kind that no FMU offers, an order without one.
        """
        for_all = self.kinds.get("")
        others = {one.kind for name, one in used.items() if name not in self.kinds}
        if for_all and for_all not in others:
            left = f"all that have no --kind of their own are {others.pop()}" if others else "each has one of its own"
            raise InputRefused(f"{where}: --kind {for_all}: no FMU is used so; {left}")
        if self.solver and all(one.kind != "model_exchange" for one in used.values()):
            both = next((name for name, one in used.items() if "model_exchange" in one.kinds), "")
            raise InputRefused(
                f"{where}: --solver {self.solver} is of FMUs for model exchange, and all are used for co-simulation; "
                f"leave it out{f', or choose --kind {both}=model_exchange' if both else ''}"
            )
        if self.order and scheme == "jacobi":
            raise InputRefused(
                f"{where}: --order says who steps first, and in Jacobi order all step at once; leave it out, or choose "
                "--scheme gauss_seidel"
            )
