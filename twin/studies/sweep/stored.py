"""The folder of a sweep: its definition, its rows, and whether it may be continued."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, TypeAdapter, with_config

# pydantic accepts only the typing_extensions version before Python 3.12.
from typing_extensions import TypedDict

from twin.kernel.atomic_write import make_folder, write_json
from twin.kernel.errors import InputRefused
from twin.kernel.files import read_bytes
from twin.studies.sweep.columns import Columns, Row
from twin.studies.sweep.rows import (
    LOOSE_SHAPE,
    MAX_RUNS,
    ROWS_FILE,
    WholeNumber,
    load_json,
    read_columns,
    read_rows,
)

if TYPE_CHECKING:
    from twin.studies.sweep.plan import SweepPlan

SWEEPS_FOLDER = Path("results/sweeps")
SWEEP_FILE = "sweep.json"
MARGINS_FILE = "margins.json"


@with_config(LOOSE_SHAPE)
class SweepFacts(TypedDict):
    """JSON structure of sweep.json: the data of a sweep without its rows, and the hashes shared by all runs."""

    sweep: str
    runs: Annotated[int, Field(ge=1, le=MAX_RUNS)]
    design: str
    drives: list[str]
    labels: list[str]
    metrics: list[str]
    limits: dict[str, float]
    configuration: dict[str, str]


@with_config(LOOSE_SHAPE)
class RunMargins(TypedDict):
    """Stability margins of a run's force loop, the smallest over the places where the robot presses.

    The gain margin is the largest stable factor on the gain, None if unlimited; the phase margin is None if the loop's
    gain never reaches 1.
    """

    run: WholeNumber
    gain: float | None
    phase_rad: float | None
    reason: str


_FACTS_ADAPTER, _MARGINS_ADAPTER = TypeAdapter(SweepFacts), TypeAdapter(dict[str, RunMargins])


@dataclass(frozen=True)
class SweepRows:
    """A stored sweep: its definition, see `SweepFile`, and the rows of its finished runs.

    Attributes:
        runs: number of planned runs, over all drives.
        columns: rows of finished runs, by run; `read` loads the rows as written.
        margins: row key -> margins of a best run; empty if margins were not computed.
    """

    name: str
    runs: int
    design: str
    drives: tuple[str, ...]
    labels: tuple[str, ...]
    metrics: tuple[str, ...]
    limits: dict[str, float]
    columns: Columns
    read: Callable[[], list[Row]]
    margins: dict[str, RunMargins] = field(default_factory=dict)

    @cached_property
    def rows(self) -> list[Row]:
        """Rows as written, with curves, sorted by run; loading them takes ten times as long as columns."""
        return sorted(self.read(), key=lambda row: row["run"])


def claim(folder: Path, plan: "SweepPlan") -> None:
    """Claim a folder for a sweep: write sweep.json, or check that the folder already belongs to the same plan."""
    facts = _read_json(folder / SWEEP_FILE, _FACTS_ADAPTER)
    if facts:
        changed = [what for what, digest in plan.configuration.items() if facts["configuration"].get(what) != digest]
        if changed:
            raise InputRefused(
                f"{folder}: holds rows of another configuration, since then {' and '.join(changed)} changed; "
                "rows of both must not be mixed: choose another --out, or move the folder away"
            )
        return
    content = {
        "sweep": plan.name,
        "experiment": plan.experiment.name,
        "runs": len(plan.tasks),
        "design": plan.definition.design,
        "drives": plan.definition.drives,
        "labels": [vary.label for vary in plan.definition.vary],
        "metrics": plan.metrics,
        "limits": plan.definition.limits,
        "configuration": plan.configuration,
    }
    make_folder(folder)
    if (folder / ROWS_FILE).exists():
        raise InputRefused(f"{folder}: has rows but no {SWEEP_FILE}, which describes them; choose another --out")
    write_json(folder / SWEEP_FILE, content)


def stored_sweep(folder: Path) -> SweepRows:
    facts = _read_json(folder / SWEEP_FILE, _FACTS_ADAPTER)
    if not facts:
        raise InputRefused(
            f"{folder}: not the folder of a sweep, {SWEEP_FILE} is missing; expected one that twin sweep, or twin run "
            "with --sweep, wrote"
        )
    path = folder / ROWS_FILE
    columns = read_columns(path)[0].by_run()
    lists = {name: tuple(facts[name]) for name in ("drives", "labels", "metrics")}
    return SweepRows(
        facts["sweep"], facts["runs"], facts["design"], limits=facts["limits"],
        columns=columns, read=lambda: read_rows(path), margins=_read_json(folder / MARGINS_FILE, _MARGINS_ADAPTER),
        **lists,
    )  # fmt: skip


def _read_json(path: Path, shape: TypeAdapter[Any]) -> dict[str, Any]:
    if not os.path.lexists(path):
        return {}
    facts = load_json(read_bytes(path), shape)
    if facts is None:
        raise InputRefused(f"{path}: not what twin sweep writes; choose another --out")
    return facts
