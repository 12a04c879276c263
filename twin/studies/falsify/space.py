"""What may be wrong, and the experiment file that says so."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.errors import InputRefused
from twin.experiment.fault_catalogue import CATALOGUE
from twin.experiment.source import toml_value
from twin.files import toml_of
from twin.studies.faults.case import GLITCH_SHARE

RANDOM = (
    "encoder_dropout_hold", "encoder_dropout_zero", "encoder_dropout_nan", "encoder_glitch", "sample_jitter",
    "sample_loss",
)  # fmt: skip
"""Kinds whose seed matters."""


@dataclass(frozen=True)
class Wrong:
    """One fault in one run.

    Attributes:
        kind: of the catalogue; "": nothing is wrong.
        target: one of the kind's.
        magnitude: in the catalogue's unit; None where the kind has none.
        onset: tick.
        body: what is pressed on; None: the experiment's own.
        seed: of the fault, and added to that of the encoders' noise.
    """

    kind: str
    target: str = ""
    magnitude: float | None = None
    onset: int = 0
    body: str | None = None
    seed: int = 0


@dataclass(frozen=True)
class Space:
    """Where the search looks.

    Attributes:
        base: keys and values of a TOML file that every run has: settings.
        requirements: (name, formula) of each.
        kinds: of faults.
        ticks: of the experiment; a fault begins before that.
        tick: (s).
        duration: of each fault (s); None: to the end.
        bodies: None among them: the experiment's own.
        seed: of the experiment.
        noisy: whether its encoders have noise.
    """

    base: Mapping[str, str]
    requirements: Sequence[tuple[str, str]]
    kinds: Sequence[str]
    ticks: int
    tick: float
    duration: float | None
    bodies: Sequence[str | None]
    seed: int
    noisy: bool = False

    def draws(self, kind: str) -> bool:
        """Whether another seed makes another run of a fault of `kind`."""
        return self.noisy or kind in RANDOM

    def magnitude(self, kind: str, share: float) -> float | None:
        """Of `kind`, `share` of the way from its smallest to its largest in the catalogue, by ratio."""
        magnitudes = CATALOGUE[kind].magnitudes
        if magnitudes is None:
            return None
        smallest, largest = magnitudes[0], magnitudes[-1]
        # four digits are enough of a search, and the largest is the catalogue's to the last bit
        return largest if share >= 1.0 else float(f"{smallest * (largest / smallest) ** share:.4g}")

    def file(self, wrong: Wrong, experiment: Path, comments: Sequence[str] = ()) -> str:
        """The experiment with what is wrong in it and what is required of it, as TOML that `twin run` takes.

        Args:
            experiment: the file that it extends, as it is found from where it will stand.
        """
        top = {"extends": toml_value(str(experiment)), **self.base}
        if wrong.body is not None:
            top["contact.body"] = toml_value(wrong.body)
        if wrong.seed:
            top["seed"] = str(self.seed + wrong.seed)
        lines = [f"# {comment}" for comment in comments] + [f"{key} = {value}" for key, value in top.items()]
        if wrong.kind:
            lines += ["", "[[fault]]", *(f"{key} = {toml_value(value)}" for key, value in self._table(wrong).items())]
        for name, formula in self.requirements:
            table = {"name": name, "kind": "requirement", "formula": formula}
            lines += ["", "[[measure]]", *(f"{key} = {toml_value(value)}" for key, value in table.items())]
        return "\n".join(lines) + "\n"

    def _table(self, wrong: Wrong) -> dict[str, Any]:
        known = CATALOGUE[wrong.kind]
        table: dict[str, Any] = {"kind": wrong.kind, "target": wrong.target, "onset_s": self.onset(wrong)}
        if self.duration is not None:
            table["duration_s"] = self.duration
        if known.magnitude_key is not None:
            table[known.magnitude_key] = wrong.magnitude
        if known.has_share:
            table["share"] = GLITCH_SHARE
        return table | ({"seed": wrong.seed} if wrong.seed else {})

    def onset(self, wrong: Wrong) -> float:
        """When it begins (s), without the digits that rounding leaves."""
        return float(f"{wrong.onset * self.tick:.12g}")


def settings_as_toml(settings: Sequence[str]) -> dict[str, str]:
    """`--set` texts as keys and values of a TOML file; a bare word is text, as it is on the command line."""
    found = {}
    for text in settings:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise InputRefused(f"--set {text}: expected key=value, for example controller.force.reference_N=4")
        try:
            toml_of(f"value = {value.strip()}", "")
        except InputRefused:
            value = json.dumps(value.strip())
        found[key.strip()] = value.strip()
    return found
