"""State of a page: an experiment with changed values, another drive or another body.

The page sends only keys and plain values. It cannot choose files: it names a drive or body that the server has listed.
"""

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import tomlkit

from twin.kernel.atomic_write import write_text
from twin.kernel.errors import InputRefused, nearest
from twin.report.explore.catalogue import PACE_KEY, Slider, check_value, sliders
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.command_words import run_command, run_words
from twin.robot.experiment.drive_files import locate_drive
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.experiment_files import BODY_FOLDERS, drive_names, experiment_file
from twin.robot.experiment.fault import FAULT_KINDS, GLITCH_SHARE
from twin.robot.experiment.source import Source, apply_overrides, key_names, merge_tables, toml_value, value_at
from twin.robot.paths import locate_file

MAX_FAULTS = 8
MAX_KEYS = 200
SAVED_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
FAULT_BY_FIELD = {"k_s_share": "spring_softened", "slip": "belt_slip"}
"""Parameters of one joint, which no key sets -> kind of a fault from the start that sets them."""
CONTACT_KEY = "contact.stiffness_N_per_m"


@dataclass(frozen=True)
class PageBase:
    """Command-line options of the explorer as given, equal for all pages; `settings` without a slider apply always."""

    experiment: str
    drive: str | None = None
    body: str | None = None
    settings: tuple[str, ...] = ()

    @property
    def drives(self) -> dict[str, str]:
        """Available drives: name -> value of `--drive`."""
        given = {self.drive: self.drive} if self.drive else {}
        return given | {name: name for name in drive_names(locate_file("fmus", Path.cwd()))}

    @property
    def bodies(self) -> dict[str, str]:
        """Available bodies: name -> value of `--body`."""
        known = {body.stem for folder in BODY_FOLDERS for body in locate_file(folder, Path.cwd()).glob("*.toml")}
        return ({self.body: self.body} if self.body else {}) | {name: name for name in sorted(known)}


@dataclass(frozen=True)
class PageState:
    """Checked state of a page: drive and body (None: the file's own), changed values, faults beyond the file's.

    `values` are by key, as in a file; for `PACE_KEY` the factor.
    """

    base: PageBase
    drive: str | None
    body: str | None
    values: Mapping[str, Any]
    faults: tuple[Mapping[str, Any], ...] = ()

    @property
    def base_experiment(self) -> Experiment:
        """The page's experiment without the changed `values`."""
        return base_experiment(self.base, self.drive, self.body)

    @property
    def settings(self) -> list[str]:
        """Values changed on the page, as `--set` options."""
        texts = []
        for key, value in self.values.items():
            if key == PACE_KEY:
                value = tuple(t / value for t in value_at(self.base_experiment.values, PACE_KEY))
            texts.append(f"{key}={toml_value(value)}")
        if self.faults:
            tables = map(_inline, (*self.base_experiment.values.get("fault", ()), *self.faults))
            texts.append(f"fault=[{', '.join(tables)}]")
        return [*self.base.settings, *texts]

    def load(self) -> Experiment:
        return load_experiment(self.base.experiment, self.settings, self.drive, self.body)

    @property
    def command(self) -> str:
        """Shell command that runs the experiment as changed on the page."""
        return run_command(run_words(self.base.experiment, self.settings, self.drive, self.body))


def _inline(table: Mapping[str, Any]) -> str:
    return "{" + ", ".join(f"{key}={toml_value(value)}" for key, value in table.items()) + "}"


@lru_cache(16)
def base_experiment(base: PageBase, drive: str | None, body: str | None) -> Experiment:
    """Load the command line's experiment with another drive and body, otherwise unchanged."""
    return load_experiment(base.experiment, base.settings, drive, body)


@lru_cache(16)
def known_sliders(base: PageBase, drive: str | None, body: str | None) -> dict[str, Slider]:
    return sliders(base_experiment(base, drive, body))


def parse_state(base: PageBase, state: Any) -> PageState:
    """Check and parse the untrusted state that an explorer page sends.

    {"set": {key: value}, "drive": name, "body": name, "faults": [{"kind", "target", "onset_s", ..}]}, all optional.
    """
    if not isinstance(state, dict) or state.keys() - {"set", "drive", "body", "faults"}:
        raise InputRefused("state: expected set, drive, body and faults")
    drive = _one_of("drive", state["drive"], base.drives) if state.get("drive") else None
    body = _one_of("body", state["body"], base.bodies) if state.get("body") else None
    changed = state.get("set") or {}
    if not isinstance(changed, dict) or len(changed) > MAX_KEYS:
        raise InputRefused(f"state: expected at most {MAX_KEYS} keys with values")
    there, faults = known_sliders(base, drive, body), state.get("faults") or []
    if not isinstance(faults, list) or len(faults) > MAX_FAULTS:
        raise InputRefused(f"state: expected at most {MAX_FAULTS} faults")
    values = {key: check_value(there, key, value) for key, value in changed.items()}
    return PageState(base, drive, body, values, tuple(map(_fault, faults)))


def adopt_state(base: PageBase, state: Any, accepted: Any) -> dict[str, Any]:
    """Add a session's accepted parameters (untrusted, see `accepted_values`) to a page's state, as keys and faults."""
    k_s = parse_state(base, state).load().plant.k_s
    found = {**state, "set": dict(state.get("set") or {}), "faults": list(state.get("faults") or [])}
    for one in accepted:
        field, value = one["field"], one["value"]
        if field == "K":
            found["set"][CONTACT_KEY] = _round_digits(value)
            continue
        if field not in FAULT_BY_FIELD:
            raise InputRefused(f"{one['text']}: no key of an experiment and no fault represents it")
        kind, target = FAULT_BY_FIELD[field], f"joint_{one['leg'] + 1}"
        magnitude = _round_digits(value / k_s if field == "k_s_share" else math.degrees(value))
        others = [fault for fault in found["faults"] if (fault["kind"], fault["target"]) != (kind, target)]
        found["faults"] = [*others, {"kind": kind, "target": target, "onset_s": 0.0, "magnitude": magnitude}]
    parse_state(base, found).load()
    return found


def _round_digits(value: float) -> float:
    """Round a number to the five significant digits that are displayed."""
    return float(f"{value:.5g}")


def _fault(table: Any) -> dict[str, Any]:
    """Check a page's table of [[fault]]; the experiment checks the bounds of its numbers."""
    name = table.get("kind") if isinstance(table, dict) else None
    if not isinstance(name, str) or name not in FAULT_KINDS:
        raise InputRefused(f"fault {str(name)[:80]!r}: no such kind; {nearest(str(name)[:80], FAULT_KINDS)}")
    kind = FAULT_KINDS[name]
    if table.get("target") not in kind.targets:
        raise InputRefused(f"fault {name}: expected a target of {', '.join(kind.targets)}")
    keys = {"onset_s": "onset_s", **({kind.magnitude_key: "magnitude"} if kind.magnitude_key else {})}
    numbers: dict[str, Any] = {"kind": name, "target": table["target"]}
    for key, place in keys.items():
        value = table.get(place)
        if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
            raise InputRefused(f"fault {name}: expected a number for {key}")
        numbers[key] = float(value)
    return numbers | ({"share": GLITCH_SHARE} if kind.has_share else {})


def _one_of(what: str, name: Any, files: Mapping[str, str]) -> str:
    if not isinstance(name, str) or name not in files:
        raise InputRefused(f"{what} {str(name)[:80]!r}: no such {what}; {nearest(str(name)[:80], files)}")
    return files[name]


def first_state(base: PageBase, settings: Sequence[str]) -> tuple[PageBase, dict[str, Any]]:
    """Split the command line's --set options into (base with those without a slider, initial page state)."""
    names = {"drive": base.drive, "body": base.body}
    there = known_sliders(replace(base, settings=()), base.drive, base.body)
    rest, changed = [], {}
    for text in settings:
        key, value = _single(text)
        if key in there and key != PACE_KEY:
            changed[key] = check_value(there, key, value)
        else:
            rest.append(text)
    held = PageBase(base.experiment, base.drive, base.body, tuple(rest))
    return held, {"set": changed, **{key: name for key, name in names.items() if name}}


def _single(text: str) -> tuple[str, Any]:
    """Parse a --set option "a.b=1" into (dotted key, value)."""
    source = Source()
    apply_overrides(source, [text])
    names = key_names(text.partition("=")[0].strip())
    node: Any = source.values
    for name in names:
        node = node[name] if isinstance(node, dict) and name in node else None
    return ".".join(names), node


def save_experiment(state: PageState, name: str) -> Path:
    """Write an experiment file to the current folder that extends the original one with a page's changes."""
    if not SAVED_NAME.fullmatch(name):
        raise InputRefused(f"{name[:80]!r}: expected a name of letters, digits, - and _")
    path = Path(f"{name}.toml")
    if os.path.lexists(path):
        raise InputRefused(f"{path}: is there already, and is not overwritten; choose another name")
    meant = state.load()
    write_text(path, extension_text(state, path))
    try:
        again = load_experiment(path)
        differing = ", ".join(key for key in meant.values if again.values.get(key) != meant.values[key])
        if differing:
            raise InputRefused(f"{path}: a file cannot express this --set option ({differing}); use 'copy command'")
    except InputRefused:
        path.unlink()
        raise
    return path


def extension_text(state: PageState, path: Path) -> str:
    """Return the text of an experiment file at `path` that extends the original one with a page's changes."""
    old = experiment_file(state.base.experiment).resolve()
    here = path.resolve().parent
    source = Source()
    if state.drive:
        source.select_file("drive", "fmu", locate_drive(state.drive, old.parent))
    if state.body:
        source.select_file("contact", "body", str(state.body))
        # --body keeps the height of the surface; a file must set it
        source.values["contact"]["height_mm"] = value_at(state.base_experiment.values, "contact.height_mm")
    document = tomlkit.document()
    document.add(tomlkit.comment(f"What twin explore has changed in {old.name}"))
    document.add("extends", tomlkit.item(os.path.relpath(old, here) if old.is_relative_to(here) else str(old)))
    tables: dict[str, Any] = dict(source.values)
    for text in state.settings:
        node = Source()
        apply_overrides(node, [text])
        tables = merge_tables(tables, node.values)
    for key, value in tables.items():
        document.add(key, tomlkit.item(value))
    return tomlkit.dumps(document)
