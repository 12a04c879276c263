"""What a supervisor knows of a job: what the job has said, and what the black box shows."""

from dataclasses import dataclass, field
from typing import Any

from twin.runs.guard.black_box import BlackBox


@dataclass(frozen=True)
class Participant:
    """A component as the job described it.

    Attributes:
        name, label: see `twin.cosim.component.Component`.
        function: the FMI function its step calls, or empty.
        sampled: whether it is evaluated at a time rather than stepped over one.
        first_input: where its inputs start in the black box.
        inputs: (name, size, unit) of each input port.
    """

    name: str
    label: str
    function: str
    sampled: bool
    first_input: int
    inputs: tuple[tuple[str, int, str], ...]


@dataclass(frozen=True)
class Stepped:
    """The system being stepped: tick (s), number of the last tick, components in the order of the mark."""

    tick: float
    last_tick: int
    components: tuple[Participant, ...]


@dataclass
class Account:
    """Attributes:
    stepped: None while components are being made.
    unstepped: what to say of the time while `stepped` is None.
    helpers: component -> the process it lives in.
    """

    stepped: Stepped | None = None
    unstepped: str = "before the first step"
    helpers: dict[str, int] = field(default_factory=dict)

    def take(self, report: dict[str, Any]) -> None:
        """Learn from a report of the kinds "loading", "stepping" and "helper"; others tell nothing."""
        if "loading" in report:
            self.stepped = None
            self.helpers.clear()
        elif "helper" in report:
            name, pid = report["helper"]
            self.helpers[name] = pid
        elif "stepping" in report:
            facts = report["stepping"]
            components = tuple(
                Participant(**{**c, "inputs": tuple((name, size, unit) for name, size, unit in c["inputs"])})
                for c in facts["components"]
            )
            self.stepped = Stepped(facts["tick"], facts["last_tick"], components)

    def stepping(self, box: BlackBox) -> Participant | None:
        """The component whose step is running, or was when the process ended."""
        component = box.mark()[1]
        return self.stepped.components[component] if self.stepped and component >= 0 else None

    def busy(self, box: BlackBox) -> bool:
        """Whether a call into a component is running."""
        return box.call() is not None or self.stepping(box) is not None
