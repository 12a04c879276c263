"""How long and how large a guarded job may become."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Limits that the supervisor enforces by ending the job.

    Attributes:
        step: longest time of one call into a component (s). What calls nobody, a compilation say, has no such limit.
        wall: longest time of the whole job (s).
        memory: most resident memory (bytes); watched where the system has /proc, so on Linux.
    """

    step: float = 10.0
    wall: float = math.inf
    memory: float = 4e9
