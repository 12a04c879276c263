"""Check of an FMU against the reference results shipped with it: a bare run, signals by name, no contract, no robot.

Results, inputs and parameters of an experiment are inside the FMU, listed in its manifest (FMI-LS-REF,
https://modelica.github.io/fmi-ls-ref/main) as in the Reference FMUs; or in the same folder, as in the FMI Cross-Check,
https://github.com/modelica/fmi-cross-check. Signals over time are CSV, the first column is the time in s.
"""

import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from twin.kernel.archive import entries, entry_of, read_entry
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.signals import playback
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, EndRequest, InputRefused, TwinError
from twin.kernel.files import parse_xml, read_bytes
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import FmuDescription, described
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.fmi.variable import Setup, Value, Variable, given_values, parse_number
from twin.kernel.process.guard import JobFailure, JobLoadFailure, run_guarded
from twin.kernel.process.job import JobLimits
from twin.kernel.process.reporter import Reporter
from twin.kernel.recording.logs.csv_table import parse_table
from twin.kernel.ssp.ssd import parameter_set
from twin.robot.assembly.drives import plan_drive
from twin.robot.experiment.schema import Drive
from twin.studies.command import Answer
from twin.studies.metrics.response import Curve
from twin.studies.result import count_text, labelled_lines, wrap_text

STANDARD_NAME = "org.fmi-standard.fmi-ls-ref"
MANIFEST_FOLDER = f"extra/{STANDARD_NAME}"
MANIFEST_FILE = f"{MANIFEST_FOLDER}/fmi-ls-manifest.xml"
MANIFEST_NAMESPACE = "{http://fmi-standard.org/fmi-ls-manifest}"
MAX_RELATED_FILES = 1_000
"""Maximum number of files in a manifest; real manifests list about a dozen."""
BOOLEAN_FIELD = re.compile(rb"(?<=[,;\t])(?:true|false)(?=[,;\t\r\n]|$)", re.IGNORECASE)
"""Pattern of the fields of Boolean variables in time series, as some tools write them."""
DEFAULT_STEPS = 500
"""Default number of steps of an experiment without a step size, as in FMPy and others."""
MAX_STEPS = 2_000_000
MAX_VALUES = 20_000_000
"""Maximum number of values, over all outputs and steps: 160 MB."""
RANGE_TOLERANCE = 0.01
SIZE_TOLERANCE = 1e-4
"""Relative tolerance for signals that hardly move: results are often written with six digits."""
MIN_TOLERANCE = 1e-9
TOLERANCE_NOTE = (
    f"{100 * RANGE_TOLERANCE:g} % of a signal's range in the results, at some moment within one step of that of the "
    "result: twin's default; the files have no tolerance"
)
"""Text of the tolerance. One step in time, because inputs are held for a step and a jump appears at its end."""
MAX_EXACT_INTEGER = 2.0**53
"""Limit of whole numbers: larger ones do not fit the doubles exchanged between components."""
TRIAL_JOB = "twin.studies.reference.outcome:outcome_fields"
BAD_OUTCOMES = ("lost", "failed", "differs", "refused")
"""Outcomes that fail, worst first."""


@dataclass(frozen=True)
class Trial:
    """A reference experiment shipped with an FMU; its times are taken from the FMU's default experiment.

    Attributes:
        results, stimuli, parameters: file names; "" without such a file.
        inside: whether the files are entries of the archive; else they are in the folder of the FMU.
    """

    name: str
    results: str = ""
    stimuli: str = ""
    parameters: str = ""
    inside: bool = False


@dataclass(frozen=True)
class Series:
    """Signals over time, read from a CSV file with reference results or inputs.

    Attributes:
        t: time (s), not descending, (rows,); a repeated time is a jump.
        signals: column name -> values, (rows,).
        others: names of columns that do not contain single numbers.
    """

    where: str
    t: Curve
    signals: dict[str, Curve]
    others: tuple[str, ...] = ()

    def hold_at(self, name: str, t: Curve) -> Curve:
        """Sample a signal at the times `t` by zero-order hold; before the first row its first value."""
        return self.signals[name][self._last(t)]

    def interpolate_at(self, name: str, t: Curve) -> Curve:
        """Interpolate a signal linearly at the times `t`; at a jump use the value after it."""
        values, last = self.signals[name], self._last(t)
        following = np.minimum(last + 1, len(self.t) - 1)
        span = self.t[following] - self.t[last]
        share = np.clip(np.divide(t - self.t[last], span, out=np.zeros(len(t)), where=span > 0.0), 0.0, 1.0)
        return np.asarray(values[last] + share * (values[following] - values[last]))

    def _last(self, t: Curve) -> np.ndarray:
        # The time of a tick is a product and may be below the row's time by a rounding error.
        near = t + 1e-9 * max(1.0, float(np.abs(self.t).max()))
        return np.maximum(np.searchsorted(self.t, near, side="right") - 1, 0)


@dataclass(frozen=True)
class TrialFiles:
    """Contents of a reference experiment: parameters in the FMU's units, series or None without a file."""

    parameters: dict[str, Value]
    stimuli: Series | None
    results: Series | None


@dataclass(frozen=True)
class ReferenceFiles:
    """Reference experiments of an FMU, and (name, reason) of unsupported experiments, parameters, results."""

    unread: tuple[tuple[str, str], ...]
    trials: tuple[Trial, ...]


def reference_files(file: Path) -> ReferenceFiles:
    """Find the reference experiments shipped with an FMU, without running or unpacking it."""
    results, parameters, unread = [], "", []
    names = entries(file)
    for source, role, type_ in _manifest_entries(file, names):
        entry = entry_of(source, names, MANIFEST_FILE)
        if role not in ("experiment", "parameter", "result"):
            continue
        if not entry:
            unread.append((source, "not in the FMU; expected the name of one of its files"))
        elif role == "result" and (type_ == "text/csv" or entry.endswith(".csv")):
            results.append(entry)
        elif role == "parameter" and entry.endswith(".ssv") and not parameters:
            parameters = entry
        else:
            unread.append(
                (source, f"{role} of type {type_}; only results (CSV) and one set of parameters (SSV) are read")
            )
    trials = [
        Trial(PurePosixPath(entry).name, entry, fed if (fed := _inputs_of(entry)) in names else "", parameters, True)
        for entry in results
    ]
    return ReferenceFiles(tuple(unread), (*trials, *_cross_check_trials(file)))


def _manifest_entries(file: Path, names: dict[str, int]) -> list[tuple[str, str, str]]:
    """Return (source, role, type) of the files listed in an FMU's manifest of reference files."""
    if MANIFEST_FILE not in names:
        return []
    where = f"{file}: {MANIFEST_FILE}"
    root = parse_xml(read_entry(file, MANIFEST_FILE), where)
    named = root.get(f"{MANIFEST_NAMESPACE}fmi-ls-name")
    if root.tag != "fmiReferences" or named != STANDARD_NAME:
        raise InputRefused(f"{where}: <{root.tag}> of '{named}'; expected <fmiReferences> of '{STANDARD_NAME}'")
    listed = root.findall("Related")
    if len(listed) > MAX_RELATED_FILES:
        raise InputRefused(f"{where}: lists {len(listed)} files; expected at most {MAX_RELATED_FILES}")
    return [(e.get("source", ""), e.get("role", "").split("/")[0], e.get("type", "not stated")) for e in listed]


def _inputs_of(results: str) -> str:
    """Return the name of the inputs file, NAME_in.csv, for reference results NAME_ref.csv or NAME_out.csv."""
    return re.sub(r"(_ref|_out)?\.csv$", "_in.csv", results)


def _cross_check_trials(file: Path) -> list[Trial]:
    """Find the FMI Cross-Check experiment, NAME_ref.csv and NAME_in.csv in the folder of NAME.fmu."""
    results = file.with_name(f"{file.stem}_ref.csv")
    stimuli = _inputs_of(results.name)
    found = Trial(results.name, results.name, stimuli if file.with_name(stimuli).is_file() else "")
    return [found] if results.is_file() else []


def read_trial(file: Path, trial: Trial, description: FmuDescription) -> TrialFiles:
    def read(name: str) -> tuple[bytes, str]:
        if trial.inside:
            return read_entry(file, name), f"{file.name}: {PurePosixPath(name).name}"
        return read_bytes(file.with_name(name)), name

    parameters = parameters_of(*read(trial.parameters), description) if trial.parameters else {}
    stimuli, results = (series_of(*read(name)) if name else None for name in (trial.stimuli, trial.results))
    return TrialFiles(parameters, stimuli, results)


def parameters_of(content: bytes, where: str, description: FmuDescription) -> dict[str, Value]:
    """Parse the parameter values of a reference experiment (SSV), in the FMU's own units."""
    given: dict[str, Value] = {}
    for one in parameter_set(content, where).parameters:
        known = description.variables.get(one.name)
        if known is not None and one.unit not in ("", None, known.unit):
            raise InputRefused(f"{where}: {one.name} in '{one.unit}'; expected '{known.unit}', as in the FMU")
        values = given_values(one, where)
        given[one.name] = values[0] if len(values) == 1 else values
    try:
        description.settings(given)
    except InputRefused as refusal:
        raise InputRefused(f"{where}: {str(refusal).removeprefix(f'{description.path}: ')}") from None
    return given


def series_of(content: bytes, where: str) -> Series:
    numbers = BOOLEAN_FIELD.sub(lambda field: b"1" if field[0].lower() == b"true" else b"0", content)
    table = parse_table(Path(where), io.BytesIO(numbers))
    time = table.head[0]
    if wrong := table.wrong_fields(time):
        raise InputRefused(f"{where} line {wrong.line}: time '{wrong.text}'; expected seconds in the first column")
    t = table.column(time)
    if len(back := np.flatnonzero(np.diff(t) < 0.0)):
        k = back[0] + 1
        raise InputRefused(
            f"{where} line {table.lines[k]}: time falls from {t[k - 1]:g} to {t[k]:g} s; expected rising"
        )
    signals, others = {}, []
    for name in table.head[1:]:
        wrong = table.wrong_fields(name)
        if wrong is None:
            signals[name] = table.column(name)
        elif wrong.count == len(table.values) and wrong.texts:
            others.append(name)
        else:
            raise InputRefused(f"{where} line {wrong.line}: {name} is '{wrong.text}'; expected a finite number")
    return Series(where, t, signals, tuple(others))


@dataclass(frozen=True)
class BareRun:
    """A run of an FMU by itself, without a robot.

    Attributes:
        step: time between two rows (s).
        t: time (s), (rows,).
        signals: variable name -> values in the FMU's own units, the first element of an array, (rows,).
        unknown: requested names that are not a single number of this FMU.
    """

    step: float
    t: Curve
    signals: dict[str, Curve]
    unknown: tuple[str, ...]
    failure: ComponentFailed | None = None


def bare_run(description: FmuDescription, trial: Trial, files: TrialFiles, ended: Callable[[BareRun], None]) -> None:
    """Run an FMU by itself in its default experiment; without a stop time, until the end of the reference results.

    Args:
        ended: callback, called with the run before the FMU is freed, which crashes some FMUs.
    """
    step, last = _steps(description, trial, files.results)
    outputs, unknown = _output_ports(description, files.results)
    if (last + 1) * (values := sum(p.port.size for p in outputs)) > MAX_VALUES:
        raise InputRefused(f"{description.path.name}: {last} steps of {values} signals; expected fewer")
    inputs = _inputs(description, files.stimuli)
    stimuli = _sample_inputs(inputs, files.stimuli, step * np.arange(last + 1, dtype=float))
    start = dict(zip((p.port.name for p in inputs), stimuli[0], strict=True))
    setup = Setup(description.tolerance, step * last, step)
    set_ = description.settings(files.parameters)
    folder = unpacked(description.path, description.sha256)
    try:
        component = FmuComponent("fmu", description, folder, inputs, outputs, set_, start, setup=setup)
    except InputRefused as refusal:
        raise ComponentFailed(str(refusal)) from None
    try:
        wires = [(f"signals.{p.port.name}", f"fmu.{p.port.name}") for p in inputs]
        signals = [playback(tuple(p.port for p in inputs), stimuli)] if inputs else []
        system = System([*signals, component], wires, step)
        simulation = Simulation(system, last)
        slices = []
        while not simulation.is_over:
            slices.append(simulation.advance().copy())
        rows = np.concatenate(slices)
        watched = {p.variable.name: rows[:, system.columns(f"fmu.{p.port.name}").start] for p in outputs}
        ended(BareRun(step, step * np.arange(len(rows), dtype=float), watched, unknown, simulation.failure))
    finally:
        component.close()


def _steps(description: FmuDescription, trial: Trial, results: Series | None) -> tuple[float, int]:
    """Return step size (s) and number of steps of an FMU's default experiment."""
    stated = description.model.defaultExperiment
    start = _first_number(getattr(stated, "startTime", None))
    # Default stop time: the end of the results, or FMPy's default.
    stop = _first_number(getattr(stated, "stopTime", None)) or (1.0 if results is None else float(results.t[-1]))
    if start:
        raise InputRefused(f"{trial.name}: starts at {start:g} s; expected 0 s, where runs begin here")
    own = getattr(description.interface, "fixedInternalStepSize", None)
    step = _first_number(own, getattr(stated, "stepSize", None)) or stop / DEFAULT_STEPS
    if not (0.0 < step <= stop and stop / step <= MAX_STEPS):
        raise InputRefused(f"{trial.name}: steps of {step:g} s until {stop:g} s; expected 1 to {MAX_STEPS} of them")
    return step, math.floor(stop / step + 1e-9)


def _first_number(*stated: object) -> float | None:
    """Return the first finite number of several stated ones; None without any."""
    return next((found for found in map(parse_number, stated) if math.isfinite(found)), None)


def _output_ports(description: FmuDescription, results: Series | None) -> tuple[list[FmuPort], tuple[str, ...]]:
    """Return FMU ports for the reference results (else outputs, a local, any), and results without a single number."""
    numbers = {v.name: v for v in description.variables.values() if v.kind >= 0}
    asked = () if results is None else (*results.signals, *results.others)
    unknown = tuple(name for name in asked if name not in numbers or numbers[name].size > 1)
    chosen = [numbers[name] for name in results.signals if name not in unknown] if results else []
    chosen = chosen or [v for v in numbers.values() if v.causality == "output"]
    chosen = chosen or [v for v in numbers.values() if v.causality == "local"][:1] or list(numbers.values())[:1]
    if not chosen:
        raise InputRefused(f"{description.path.name}: has no numeric variable")
    return _ports("y", chosen), unknown


def _inputs(description: FmuDescription, stimuli: Series | None) -> list[FmuPort]:
    if stimuli is None:
        return []
    offered = {v.name: v for v in description.variables_of("input") if v.size == 1}
    for name in (*stimuli.signals, *stimuli.others):
        if name not in offered or name in stimuli.others:
            raise InputRefused(f"{stimuli.where}: column '{name}' is not a numeric input of {description.path.name}")
        if np.abs(stimuli.signals[name]).max() >= MAX_EXACT_INTEGER and not _continuous(offered[name]):
            raise InputRefused(f"{stimuli.where}: column '{name}' has whole numbers of more than 53 bits")
    return _ports("u", [offered[name] for name in stimuli.signals])


def _ports(letter: str, variables: list[Variable]) -> list[FmuPort]:
    """Return numbered ports for FMU variables, whose names may contain characters invalid in wires."""
    return [FmuPort(Port(f"{letter}{n}", v.size, v.unit or "1"), v) for n, v in enumerate(variables)]


def _sample_inputs(inputs: list[FmuPort], stimuli: Series | None, t: Curve) -> np.ndarray:
    """Sample an FMU's inputs at the times `t`, (times, inputs): real numbers linearly, whole numbers held."""
    if stimuli is None:
        return np.zeros((len(t), 0))
    sample = {True: stimuli.interpolate_at, False: stimuli.hold_at}
    return np.column_stack([sample[_continuous(p.variable)](p.variable.name, t) for p in inputs])


def _continuous(variable: Variable) -> bool:
    return variable.type in ("Real", "Float64", "Float32")


class SignalDeviation(NamedTuple):
    """Largest deviation of a signal from the reference results, in multiples of the tolerance, and its time (s)."""

    signal: str
    share: float
    t: float


def deviations(run: BareRun, results: Series) -> list[SignalDeviation]:
    within = results.t <= (1.0 + 1e-9) * run.t[-1]
    t = results.t[within]
    if not len(t):
        return []
    place = np.floor(t / run.step + 1e-6).astype(int)
    near = np.clip(place[:, None] + np.array([-1, 0, 1, 2]), 0, len(run.t) - 1)
    found = []
    for name, ours in run.signals.items():
        if name not in results.signals:
            continue
        theirs = results.signals[name][within]
        band = max(RANGE_TOLERANCE * np.ptp(theirs), SIZE_TOLERANCE * np.abs(theirs).max(), MIN_TOLERANCE)
        low, high = ours[near].min(axis=1), ours[near].max(axis=1)
        beyond = np.maximum(np.maximum(low - theirs, theirs - high), 0.0) / band
        worst = int(np.argmax(beyond))
        found.append(SignalDeviation(name, float(beyond[worst]), float(t[worst])))
    return found


@dataclass(frozen=True)
class ReferenceOutcome:
    """Outcome of a reference experiment, with the deviations by signal in tolerances.

    Attributes:
        word: "agrees" or "differs", "ran" without results to compare, "refused" before it ran, "failed", or "lost" if
            its process crashed, hung or outgrew its limits.
    """

    experiment: str
    word: str
    detail: str
    deviations: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class References:
    """The reference experiments of an FMU and their outcomes."""

    file: Path
    reference_files: ReferenceFiles
    outcomes: tuple[ReferenceOutcome, ...]

    @property
    def holds(self) -> bool:
        """Whether no reference experiment failed."""
        return not any(outcome.word in BAD_OUTCOMES for outcome in self.outcomes)

    def to_dict(self) -> dict[str, Any]:
        return {
            "file": self.file.name,
            "unread": dict(self.reference_files.unread),
            "experiments": [asdict(outcome) for outcome in self.outcomes],
            "tolerance": TOLERANCE_NOTE,
        }


def references(file: Path, apart: bool, limits: JobLimits = JobLimits()) -> References | None:  # noqa: B008, it is frozen
    """Run an FMU's reference experiments (None without any), `apart` in processes against crashes."""
    found = reference_files(file)
    if not (found.unread or found.trials):
        return None
    outcomes = (
        _isolate_trial(file, number, trial, limits) if apart else outcome_of(file, trial)
        for number, trial in enumerate(found.trials)
    )
    return References(file, found, tuple(outcomes))


def outcome_fields(reporter: Reporter, file: str, number: int) -> dict[str, Any]:
    trial = reference_files(Path(file)).trials[number]
    return asdict(outcome_of(Path(file), trial, lambda outcome: reporter.note(outcome=asdict(outcome))))


def _isolate_trial(file: Path, number: int, trial: Trial, limits: JobLimits) -> ReferenceOutcome:
    noted: list[dict[str, Any]] = []
    try:
        # Refuse invalid files without starting a process.
        _files(file, trial)
        return ReferenceOutcome(**run_guarded(TRIAL_JOB, {"file": str(file), "number": number}, limits, noted.append))
    except (JobFailure, JobLoadFailure) as failure:
        # A crash when the FMU is freed does not change the outcome of the comparison.
        if noted:
            outcome = ReferenceOutcome(**noted[-1]["outcome"])
            return replace(outcome, detail=f"{outcome.detail}; then: {failure}")
        return ReferenceOutcome(trial.name, "lost", str(failure))
    except InputRefused as refusal:
        return ReferenceOutcome(trial.name, "refused", str(refusal))


def outcome_of(
    file: Path, trial: Trial, ended: Callable[[ReferenceOutcome], None] = lambda outcome: None
) -> ReferenceOutcome:
    """Run one reference experiment in this process and compare; `ended` gets the outcome before the FMU is freed."""
    outcomes: list[ReferenceOutcome] = []

    def judge(run: BareRun) -> None:
        outcomes.append(_judge_run(trial.name, run, files.results))
        ended(outcomes[-1])

    try:
        description, files = _files(file, trial)
        bare_run(description, trial, files, judge)
    except TwinError as trouble:
        return ReferenceOutcome(trial.name, "refused" if isinstance(trouble, InputRefused) else "failed", str(trouble))
    return outcomes[-1]


def _files(file: Path, trial: Trial) -> tuple[FmuDescription, TrialFiles]:
    description = described(file)
    return description, read_trial(file, trial, description)


def _judge_run(name: str, run: BareRun, results: Series | None) -> ReferenceOutcome:
    if not len(run.t):
        return ReferenceOutcome(name, "failed", str(run.failure))
    how = f"{count_text(len(run.t) - 1, 'step')} of {run.step:g} s"
    found = deviations(run, results) if results else []
    others = dict.fromkeys((*(results.others if results else ()), *run.unknown))
    if others:
        how += f"; not compared: {', '.join(others)}"
    if run.failure:
        # Some FMUs terminate themselves, and their results then end too.
        early = bool(found) and results is not None and results.t[-1] > run.t[-1] + (1.0 + 1e-9) * run.step
        if early or not (found or isinstance(run.failure, EndRequest)):
            return ReferenceOutcome(name, "failed", str(run.failure))
        how += f"; then, {'as its results end' if found else 'regularly'}: {run.failure}"
    if not found:
        return ReferenceOutcome(name, "ran", how)
    shares = {one.signal: one.share for one in found}
    worst = max(found, key=lambda one: one.share)
    if worst.share <= 1.0:
        detail = f"{count_text(len(shares), 'signal')}, at most {worst.share:.2g} of the tolerance off; {how}"
        return ReferenceOutcome(name, "agrees", detail, shares)
    many = sum(share > 1.0 for share in shares.values())
    off = f"{worst.signal} by {worst.share:.3g} times the tolerance at {worst.t:g} s"
    return ReferenceOutcome(
        name, "differs", f"{many} of {count_text(len(shares), 'signal')} differ, {off}; {how}", shares
    )


def drive_references(table: Drive, apart: bool) -> list[References]:
    """Run the reference experiments of each FMU of a drive, without the drive's mapping and parameters."""
    if table.sha256 or any(part.sha256 for part in table.parts.values()):
        # Check the pinned hashes before anything is run.
        plan_drive(table)
    files = [Path(fmu) for fmu in (table.fmu, *(part.fmu for part in table.parts.values())) if fmu]
    return [found for file in files if (found := references(file, apart))]


def refusal_answer(came: Sequence[References], refusal: str) -> Answer:
    facts = {"qualified": False, "refused": refusal, "references": [one.to_dict() for one in came]}
    return Answer(references_text(came), facts, 2)


def references_text(found: Sequence[References]) -> str:
    lines = []
    for one in found:
        lines += wrap_text(f"came with {one.file.name}:")
        for name, why in one.reference_files.unread:
            lines += wrap_text(f"{name}: {why}", "  --    not read   ", whole=True)
        for outcome in one.outcomes:
            start = f"  {'FAIL' if outcome.word in BAD_OUTCOMES else 'ok':4}  {outcome.word:10} "
            lines += wrap_text(f"{outcome.experiment}: {outcome.detail}", start, whole=True)
    if any(outcome.deviations for one in found for outcome in one.outcomes):
        lines += labelled_lines("note", f"tolerance: {TOLERANCE_NOTE}")
    return "\n".join(lines)
