"""SWEEP.toml: which experiment, which keys of it vary and how, on which drives. Checked as one file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from twin.errors import InputRefused
from twin.experiment.mistakes import sentences
from twin.files import read_toml
from twin.places import located
from twin.studies.sweep.vary import Vary, contradictions

DESIGNS = Literal["grid", "latin_hypercube", "sobol", "random", "saltelli"]


class Definition(BaseModel):
    """The keys of a sweep file.

    Attributes:
        experiment: file, as seen from the sweep's folder upwards.
        runs: points per drive; None in a grid, whose levels say it. design = "saltelli": blocks of as many points as
            parameters and two more.
        seed: of sampled designs.
        claims: "fig4": each point is run with force control and without, and the paper's claims are judged on both.
        drives: each runs every point; empty: the experiment's own.
        limits: metric -> most that a run may have of it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    experiment: str
    design: DESIGNS = "grid"
    runs: int | None = Field(None, ge=1)
    seed: int = Field(0, ge=0, lt=2**63)
    claims: Literal["fig4"] | None = None
    drives: list[str] = Field(default_factory=list)
    vary: list[Vary] = Field(default_factory=list)
    limits: dict[str, float] = Field(default_factory=dict)


def read_definition(path: Path) -> tuple[Definition, Path]:
    """The sweep file at `path`, and the experiment that it names.

    Raises:
        InputRefused: no such file, not TOML, or with every mistake in it, one sentence each.
    """
    definition = _checked(read_toml(path, "sweep file"), str(path))
    return definition, located(definition.experiment, path.resolve().parent)


def short_definition(experiment: Path, ranges: Sequence[str], drive: str | None) -> Definition:
    """The grid of `ranges`, each "key=from:to:count".

    Raises:
        InputRefused: one is none, or a key is there twice.
    """
    tables = []
    for text in ranges:
        key, _, levels = text.partition("=")
        try:
            low, high, count = levels.split(":")
            tables.append({"key": key.strip(), "from": float(low), "to": float(high), "count": int(count)})
        except ValueError:
            raise InputRefused(
                f"--sweep {text}: expected key=from:to:count, for example contact.stiffness_N_per_m=500:5000:10"
            ) from None
    table = {"experiment": str(experiment), "drives": [drive] if drive else [], "vary": tables}
    return _checked(table, f"--sweep {' '.join(ranges)}")


def _checked(table: dict[str, Any], place: str) -> Definition:
    try:
        definition = Definition.model_validate(table)
        mistakes = _disagreements(definition)
    except ValidationError as error:
        mistakes = [_placed(sentence) for sentence in sentences(error, Definition, "")]
    if mistakes:
        raise InputRefused("\n".join(f"{place}: {mistake}" for mistake in mistakes))
    return definition


def _disagreements(definition: Definition) -> list[str]:
    """What no key can see alone."""
    sampled = definition.design != "grid"
    mistakes = [] if definition.vary or definition.drives else ["varies nothing; add a table [[vary]], or drives"]
    if sampled and definition.runs is None:
        mistakes.append(f"design = \"{definition.design}\": missing key 'runs'")
    if sampled and not definition.vary:
        mistakes.append(f'design = "{definition.design}": nothing to draw; add a table [[vary]], or design = "grid"')
    if not sampled and definition.runs is not None:
        mistakes.append("runs: a grid has as many runs as its levels make; remove it, or choose another design")
    if definition.design == "saltelli":
        mistakes += why_not_saltelli(definition.vary)
    if definition.design in ("sobol", "saltelli") and (runs := definition.runs or 1) & (runs - 1):
        below = 1 << (runs.bit_length() - 1)
        mistakes.append(
            f"runs = {runs}: a Sobol sequence is balanced at powers of 2 only; choose {below} or {2 * below}"
        )
    if repeated := sorted({name for name in definition.drives if definition.drives.count(name) > 1}):
        mistakes.append(f"drives: '{repeated[0]}' is named twice; a run is counted once, remove one")
    known = ["drive"] if definition.drives else []
    taken: set[str] = set()
    for number, vary in enumerate(definition.vary, start=1):
        found = contradictions(vary, sampled, known)
        found += [f"'{name}' varies already in another table; remove one" for name in vary.names if name in taken]
        mistakes += [f"[[vary]] {number}: {mistake}" for mistake in found]
        taken.update(vary.names)
        known.append(vary.label)
    return mistakes


def why_not_saltelli(tables: Sequence[Vary]) -> list[str]:
    """What in [[vary]] cannot be: the shares of a variance add up only if parameters are independent and all differ."""
    return [
        f'[[vary]] {number}: {key} does not go with design = "saltelli", whose parameters are independent numbers; '
        "remove it, or choose another design"
        for number, vary in enumerate(tables, start=1)
        for key in ("values", "when")
        if getattr(vary, key) is not None
    ]


def _placed(sentence: str) -> str:
    """The sentence without the brackets of the nameless table that the file is."""
    return sentence.replace("[.vary.when]", "[[vary]] when:").replace("[.vary]", "[[vary]]").removeprefix("[] ")
