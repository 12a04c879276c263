"""Options of the master of a system: step, times, coupling, kinds and order of its FMUs."""

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
    """Options of the co-simulation master, as given by the user.

    Attributes:
        tick, start, stop: step size, start and end of the run (s); None for the values of the system.
        scheme: "gauss_seidel" (components step in order) or "jacobi"; None for the default of the file format.
        kinds: kind of FMU to use, by component; key "" for components whose kind the system does not state.
        solver: solver for all FMUs for model exchange; None for CVODE.
        steps: step sizes by component (s).
        order: components that step first, in this order.
        loops: treatment of algebraic loops.
        lenient: whether minor violations of the standards are accepted and listed.
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
        return self.solver or "cvode"

    def refuse_unknown(self, components: Iterable[str], where: str) -> None:
        """Refuse options that name a component which the system does not have."""
        known = list(components)
        for option, names in (("--kind", self.kinds), ("--step", self.steps), ("--order", self.order)):
            for name in names:
                if name and name not in known:
                    raise InputRefused(f"{where}: {option} {name}: no such component; {nearest(name, known)}")

    def refuse_idle(self, used: "Mapping[str, FmuDescription]", scheme: "Scheme", where: str) -> None:
        """Refuse options that have no effect on the FMUs `used`, by component, as the kind in use."""
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
                f"{where}: --order has no effect with Jacobi coupling, where all step at once; leave it out, or choose "
                "--scheme gauss_seidel"
            )
