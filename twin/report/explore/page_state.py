"""What a page asks for: an experiment with other values, another drive or another body.

The page sends keys and plain values only. Which file a drive or a body is, is never for the page to say: it names one
of those that the server has listed.
"""

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
from twin.robot.experiment.experiment_files import BODY_FOLDERS, experiment_file
from twin.robot.experiment.fault import FAULT_KINDS, GLITCH_SHARE
from twin.robot.experiment.source import Source, apply_overrides, key_names, toml_value, value_at
from twin.robot.paths import locate_file

MAX_FAULTS = 8
"""That one state may have."""
MAX_KEYS = 200
"""That one state may change."""
SAVED_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
FAULT_BY_FIELD = {"k_s_share": "spring_softened", "slip": "belt_slip"}
"""Of one joint no key says anything; a fault from the start does."""
CONTACT_KEY = "contact.stiffness_N_per_m"


@dataclass(frozen=True)
class PageBase:
    """What the command line says, the same for every page.

    Attributes:
        experiment: file or name, as it was given.
        drive: --drive as it was given.
        body: --body as it was given.
        settings: --set that no slider stands for; they hold in every state.
    """

    experiment: str
    drive: str | None = None
    body: str | None = None
    settings: tuple[str, ...] = ()

    @property
    def drives(self) -> dict[str, str]:
        """Drives that can be chosen: what `--drive` takes, by name."""
        shelf = locate_file("fmus", Path.cwd())
        known = {path.parent.name for path in (*shelf.glob("*/*.fmu"), *shelf.glob("*/mapping.toml"))}
        given = {self.drive: self.drive} if self.drive else {}
        return given | {name: name for name in sorted(known)}

    @property
    def bodies(self) -> dict[str, str]:
        """Bodies that can be chosen: what `--body` takes, by name."""
        known = {body.stem for folder in BODY_FOLDERS for body in locate_file(folder, Path.cwd()).glob("*.toml")}
        return ({self.body: self.body} if self.body else {}) | {name: name for name in sorted(known)}


@dataclass(frozen=True)
class PageState:
    """One state of a page, checked.

    Attributes:
        drive: what `--drive` takes; None: the file's own.
        body: what `--body` takes; None: the file's own.
        values: by key, as a file would have them; of `PACE_KEY` the factor.
        faults: tables of [[fault]], besides those of the file.
    """

    base: PageBase
    drive: str | None
    body: str | None
    values: Mapping[str, Any]
    faults: tuple[Mapping[str, Any], ...] = ()

    @property
    def base_experiment(self) -> Experiment:
        """The experiment without `values`."""
        return base_experiment(self.base, self.drive, self.body)

    @property
    def settings(self) -> list[str]:
        """As `--set` takes them."""
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
        """The experiment."""
        return load_experiment(self.base.experiment, self.settings, self.drive, self.body)

    @property
    def command(self) -> str:
        """The command that runs it, for a shell."""
        return run_command(run_words(self.base.experiment, self.settings, self.drive, self.body))


def _inline(table: Mapping[str, Any]) -> str:
    return "{" + ", ".join(f"{key}={toml_value(value)}" for key, value in table.items()) + "}"


@lru_cache(16)
def _load_base(experiment: str, settings: tuple[str, ...], drive: str | None, body: str | None) -> Experiment:
    return load_experiment(experiment, settings, drive, body)


def base_experiment(base: PageBase, drive: str | None, body: str | None) -> Experiment:
    """The experiment of the command line with a drive and a body, before anything is changed."""
    return _load_base(base.experiment, base.settings, drive, body)


@lru_cache(16)
def _base_sliders(experiment: str, settings: tuple[str, ...], drive: str | None, body: str | None) -> dict[str, Slider]:
    return sliders(_load_base(experiment, settings, drive, body))


def known_sliders(base: PageBase, drive: str | None, body: str | None) -> dict[str, Slider]:
    """The sliders of the experiment with a drive and a body."""
    return _base_sliders(base.experiment, base.settings, drive, body)


def parse_state(base: PageBase, state: Any) -> PageState:
    """What the `state` of a page asks for.

    Args:
        state: {"set": {key: value}, "drive": name, "body": name, "faults": [{"kind", "target", "onset_s", ..}]};
            each may be missing. It may come from anybody.
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
    """The `state` of a page, of a robot as it is now: by its own keys and faults.

    Args:
        accepted: what a session has accepted, see `twin.studies.shadow.live_view.accepted_values`; it may be anything.
    """
    k_s = parse_state(base, state).load().plant.k_s
    found = {**state, "set": dict(state.get("set") or {}), "faults": list(state.get("faults") or [])}
    for one in accepted:
        field, value = one["field"], one["value"]
        if field == "K":
            found["set"][CONTACT_KEY] = _round_digits(value)
            continue
        if field not in FAULT_BY_FIELD:
            raise InputRefused(f"{one['text']}: no key of an experiment and no fault stands for it")
        kind, target = FAULT_BY_FIELD[field], f"joint_{one['leg'] + 1}"
        magnitude = _round_digits(value / k_s if field == "k_s_share" else math.degrees(value))
        others = [fault for fault in found["faults"] if (fault["kind"], fault["target"]) != (kind, target)]
        found["faults"] = [*others, {"kind": kind, "target": target, "onset_s": 0.0, "magnitude": magnitude}]
    parse_state(base, found).load()
    return found


def _round_digits(value: float) -> float:
    """To as many digits as anybody reads."""
    return float(f"{value:.5g}")


def _fault(table: Any) -> dict[str, Any]:
    """A table of [[fault]]; whether its numbers are in bounds is left to the experiment."""
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
    """What `settings` of the command line are to a page: (the base with those that no slider stands for, the state)."""
    names = {"drive": base.drive, "body": base.body}
    there = known_sliders(PageBase(base.experiment), base.drive, base.body)
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
    """(dotted key, value) of "a.b=1"."""
    source = Source()
    apply_overrides(source, [text])
    names = key_names(text.partition("=")[0].strip())
    node: Any = source.values
    for name in names:
        node = node[name] if isinstance(node, dict) and name in node else None
    return ".".join(names), node


def save_experiment(state: PageState, name: str) -> Path:
    """Write an experiment that extends the old one with exactly what differs, in the current folder."""
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
            raise InputRefused(f"{path}: a file cannot say this as --set does ({differing}); use 'copy command'")
    except InputRefused:
        path.unlink()
        raise
    return path


def extension_text(state: PageState, path: Path) -> str:
    """The text of that file, which will be at `path`."""
    old = experiment_file(state.base.experiment).resolve()
    here = path.resolve().parent
    source = Source()
    if state.drive:
        source.select_file("drive", "fmu", locate_drive(state.drive, old.parent))
    if state.body:
        source.select_file("contact", "body", str(state.body))
        # --body leaves it as it is, a file would have to say it
        source.values["contact"]["height_mm"] = value_at(state.base_experiment.values, "contact.height_mm")
    document = tomlkit.document()
    document.add(tomlkit.comment(f"What twin explore has changed in {old.name}"))
    document.add("extends", tomlkit.item(os.path.relpath(old, here) if old.is_relative_to(here) else str(old)))
    tables: dict[str, Any] = dict(source.values)
    for text in state.settings:
        node = Source()
        apply_overrides(node, [text])
        _merge(tables, node.values)
    for key, value in tables.items():
        document.add(key, tomlkit.item(_tuples_to_lists(value)))
    return tomlkit.dumps(document)


def _merge(into: dict[str, Any], tables: Mapping[str, Any]) -> None:
    for key, value in tables.items():
        if isinstance(value, Mapping) and isinstance(into.get(key), dict):
            _merge(into[key], value)
        else:
            into[key] = dict(value) if isinstance(value, Mapping) else value


def _tuples_to_lists(value: Any) -> Any:
    """With lists, which TOML writes, where an experiment has tuples."""
    if isinstance(value, Mapping):
        return {key: _tuples_to_lists(item) for key, item in value.items()}
    return [_tuples_to_lists(item) for item in value] if isinstance(value, tuple | list) else value
