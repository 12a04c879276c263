"""Duration, steps and step order of a run: the user's options, else the statements of the system's files."""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_xml
from twin.kernel.fmi.description import STEP_TOLERANCE, FmuDescription, stated_step
from twin.kernel.fmi.variable import parse_number
from twin.kernel.ssp.flat import FlatSystem
from twin.kernel.ssp.package import Package
from twin.kernel.ssp.structure import Annotation, local_name
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.naming import SINGLE_FORM

MAX_TICKS = 1e12
DEFAULT_STEPS = 500
"""Approximate number of steps of a single FMU that states no step size; FMPy uses the same."""
STEP_ATTRIBUTES = ("stepSize", "baseStepSize")
"""Annotation attributes for the step size of OMSimulator and libcosim."""
ORDER_ANNOTATION = "twin.order"
"""Type of the system annotation that states the step order of its components."""


def step_notes(type_: str, step: float | None) -> tuple[Annotation, ...]:
    """Return the SSP annotation that states a step size (s); empty without a step."""
    return (Annotation(type_, f'<step stepSize="{step!r}" />'),) if step else ()


class Timing(NamedTuple):
    """Step size `tick` (s), first and last tick of a run (0 if unknown; no step follows), and their origins.

    `stop_source` is "" for the system or the user. `periods` are the components' steps (ticks). `rounded` notes a step
    size changed to divide the run, "" if unchanged.
    """

    tick: float
    source: str
    first: int
    ticks: int
    stop_source: str
    periods: Mapping[str, int]
    rounded: str = ""

    @property
    def duration(self) -> float:
        """Duration of the run (s)."""
        return (self.ticks - self.first) * self.tick


def timing(
    package: Package, flat: FlatSystem, descriptions: Mapping[str, FmuDescription], choice: MasterChoice
) -> Timing:
    """Determine start, end and step sizes of a run from the user's options, else the system, else its FMUs."""
    steps = _steps(package, flat, choice)
    length, source = (
        (choice.tick, "--tick-ms") if choice.tick is not None else _structure_step(package, descriptions, steps)
    )
    experiment, stop_source = package.structure.experiment, ""
    end = experiment.stop if choice.stop is None else choice.stop
    if end is None:
        end, stop_source = _latest_end(descriptions)
    if length is None and package.form == SINGLE_FORM and end is not None and end > 0.0:
        length, source = _round_step(end / DEFAULT_STEPS), f"a {DEFAULT_STEPS}th of the run, as the FMU states none"
    missing = ["step size (give --tick-ms)"] * (length is None) + ["stop time (give --stop-s)"] * (end is None)
    if length is None or end is None:
        raise InputRefused(f"{package.file}: neither the structure nor an FMU states a {' and a '.join(missing)}")
    begin = choice.start if choice.start is not None else experiment.start
    begin = _common_start(descriptions) if begin is None else begin
    if begin < 0.0:
        raise InputRefused(f"{package.file}: starts at {begin:g} s; expected 0 or later: give --start-s")
    if not 0.0 < (end - begin) / length < MAX_TICKS or end / length >= MAX_TICKS:
        raise InputRefused(
            f"{package.file}: from {begin:g} to {end:g} s in steps of {length:g} s; expected at least one step, and "
            f"fewer than {MAX_TICKS:g}"
        )
    rounded = ""
    count = max(1, round((end - begin) / length))
    if choice.lenient and abs(count * length - (end - begin)) > STEP_TOLERANCE * length:
        stated, length = length, (end - begin) / count
        rounded = f"the step of {1e3 * stated:g} ms rounded to {1e3 * length:g} ms, so that the run is {count} steps"
    first = _whole_steps(begin, length, f"{package.file}: the start at {begin:g} s", "set --start-s or --tick-ms")
    last = _whole_steps(end, length, f"{package.file}: {end:g} s", "set --stop-s or --tick-ms, or add --lenient")
    if last <= first:
        raise InputRefused(f"{package.file}: from {begin:g} to {end:g} s, less than a step of {1e3 * length:g} ms")
    periods = dict.fromkeys(descriptions, 1)
    for path, step in steps.items():
        where = f"{package.file}: the step of {path}, {1e3 * step:g} ms,"
        periods[path] = max(1, _whole_steps(step, length, where, "set --step or --tick-ms"))
        if first % periods[path] or last % periods[path]:
            raise InputRefused(
                f"{where} does not fit a run from {begin:g} to {end:g} s; expected both to be whole multiples of it"
            )
    return Timing(length, source, first, last, stop_source, periods, rounded)


def timing_inside(
    package: Package, flat: FlatSystem, descriptions: Mapping[str, FmuDescription], tick: float, every: int, ticks: int
) -> Timing:
    """Determine the step sizes of a system inside a component of another system, starting at 0 s.

    The step of a component is its annotation, else the annotation of the structure, else one step of the enclosing
    component: `every` ticks of `tick` s. The run has `ticks`, 0 if unknown.
    """
    own = _steps(package, flat, MasterChoice())
    length, source = _annotation_step(package)
    periods = {}
    for path in descriptions:
        step = own.get(path, length)
        where = f"{package.file}: the step of {path}, {1e3 * step:g} ms," if step else ""
        cure = "the annotation has to fit [cosim] tick_ms, or the drive's substeps"
        periods[path] = max(1, _whole_steps(step, tick, where, cure)) if step else every
    return Timing(tick, source or "the experiment", 0, ticks, "", periods)


def _round_step(step: float) -> float:
    """Round a step size down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(times * power for times in (5.0, 2.0, 1.0) if times * power <= step * (1.0 + 1e-9))


def step_order(package: Package, flat: FlatSystem, choice: MasterChoice) -> list[str]:
    """Return a system's components in step order: the user's, else the annotated, else the file's."""
    asked = list(choice.order) or list(_annotated_order(package, flat))
    return [*asked, *(path for path in flat.components if path not in asked)]


def _annotated_order(package: Package, flat: FlatSystem) -> Iterator[str]:
    for note in package.structure.system.annotations:
        if note.type == ORDER_ANNOTATION and note.content:
            where = f"{package.file}: annotation {ORDER_ANNOTATION}"
            for element in parse_xml(note.content.encode(), where).iter():
                if local_name(element) == "component":
                    name = element.get("name", "")
                    if name not in flat.components:
                        raise InputRefused(f"{where}: '{name}' is not a component of the system")
                    yield name


def _whole_steps(time: float, step: float, what: str, cure: str) -> int:
    count = round(time / step)
    if abs(count * step - time) > STEP_TOLERANCE * step:
        raise InputRefused(f"{what} is not a whole number of steps of {1e3 * step:g} ms; {cure}")
    return count


def _steps(package: Package, flat: FlatSystem, choice: MasterChoice) -> dict[str, float]:
    """Return the step size of each component that has its own, from the user or its annotation (s)."""
    found = {}
    for path, component in flat.components.items():
        noted = next(_annotation_steps(component.annotations, f"{package.file}: {path}"), None)
        step = choice.steps.get(path) or (noted[0] if noted else None)
        if step is not None:
            found[path] = step
    return found


def _annotation_steps(annotations: tuple[Annotation, ...], where: str) -> Iterator[tuple[float, str]]:
    """Yield (step size (s), annotation type) of the SSP annotations that state a step size."""
    for note in annotations:
        for element in (
            parse_xml(note.content.encode(), f"{where}: annotation {note.type}").iter() if note.content else ()
        ):
            for name in STEP_ATTRIBUTES:
                if 0.0 < (step := parse_number(element.get(name))) < math.inf:
                    yield step, note.type


def _structure_step(
    package: Package, descriptions: Mapping[str, FmuDescription], own: Mapping[str, float]
) -> tuple[float | None, str]:
    """Return the step size (s) and its origin: the structure's annotation, else the shortest step of the FMUs."""
    if (annotated := _annotation_step(package))[0] is not None:
        return annotated
    wanted = {path: step for path, one in descriptions.items() if 0.0 < (step := stated_step(one)) < math.inf}
    wanted |= own
    if not wanted:
        return None, ""
    shortest = min(wanted, key=lambda path: wanted[path])
    return wanted[shortest], f"what the FMU of {shortest} wants{'' if len(wanted) == 1 else ', the shortest'}"


def _annotation_step(package: Package) -> tuple[float | None, str]:
    """Return the annotated step size of the structure (s), and its origin; (None, "") without annotation."""
    structure = package.structure
    notes = (*structure.experiment.annotations, *structure.system.annotations, *structure.annotations)
    found = next(_annotation_steps(notes, f"{package.file}"), None)
    return (found[0], f"an annotation of the structure ({found[1]})") if found else (None, "")


def _latest_end(descriptions: Mapping[str, FmuDescription]) -> tuple[float | None, str]:
    """Return the latest stop time of the FMUs (s) and its origin; (None, "") if no FMU states one."""
    ends = {path: _experiment(one, "stopTime") for path, one in descriptions.items()}
    ends = {path: end for path, end in ends.items() if 0.0 < end < math.inf}
    if not ends:
        return None, ""
    latest = max(ends, key=lambda path: ends[path])
    return ends[latest], f"the default experiment of {latest}{'' if len(ends) == 1 else ', the longest'}"


def _common_start(descriptions: Mapping[str, FmuDescription]) -> float:
    """Return the start time that all FMUs with a start time share (s); 0 if they differ."""
    starts = {start for one in descriptions.values() if math.isfinite(start := _experiment(one, "startTime"))}
    return starts.pop() if len(starts) == 1 else 0.0


def _experiment(description: FmuDescription, name: str) -> float:
    return parse_number(getattr(description.model.defaultExperiment, name, None))
