"""Model descriptions of FMUs, read and checked before a binary is loaded.

FMPy reads modelDescription.xml; attributes that it ignores are added here. Declared steps, events and clocks (FMI 3.0,
2.2.8) are reported and checked against the steps that the FMU is to make.
"""

import math
import os
import platform as machine
import sys
import time
import zipfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from fmpy import platform, read_model_description, sharedLibraryExtension
from fmpy.model_description import Unknown

from twin.kernel.archive import entries, read_entry, sha256
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import parse_xml
from twin.kernel.fmi.unpacked import CompiledLibrary, compile_sources, compiled_library, has_sources, source_sets
from twin.kernel.fmi.variable import Setting, Value, Variable, parse_number, setting_value, variable_of

DESCRIPTION_FILE = "modelDescription.xml"
CLOCK_ATTRIBUTES = ("intervalDecimal", "shiftDecimal", "intervalCounter", "shiftCounter", "resolution")
"""Attributes of a Clock (FMI 3.0.2, 2.2.9)."""
FMI1_CAPABILITIES = (
    "canHandleVariableCommunicationStepSize", "canInterpolateInputs", "canBeInstantiatedOnlyOncePerProcess",
)  # fmt: skip
MAX_DESCRIPTION_SIZE = 64 << 20
"""Maximum size of a model description (bytes); the largest real ones have tens of thousands of variables and 10 MB."""
STRUCTURAL_PARAMETER = "structuralParameter"
NEEDS_TOOL, PYTHON_FMU = "needs its authoring tool while running (needsExecutionTool)", "PythonFMU"
MIN_FILE_AGE = 2_000_000_000
"""Minimum age (ns) of a file whose times identify its content: the coarsest clock of a file system, FAT."""
SCALAR_TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")
INDEX_ATTRIBUTES = ("index", "dependencies", "derivative")
"""Attributes that refer to variables by index, counted from 1 (FMI 2.0.4, 2.2.8)."""
MAX_CLOCKS = 62
"""Maximum number of clocks: each has a bit in an integer."""
STEP_TOLERANCE = 1e-6
"""Maximum deviation of a step from a multiple of another one, as a share of the step."""
Kind = Literal["co_simulation", "model_exchange"]
KIND_NAMES: dict[Kind, str] = {"co_simulation": "co-simulation", "model_exchange": "model exchange"}
"""Names of the kinds of FMUs; the first is the default for an FMU that offers both."""


def complete_model(model: Any, file: Path) -> None:
    """Add attributes to FMPy's model description that FMPy has fields for but does not read from the FMU `file`."""
    if model.fmiVersion != "1.0" and not model.fmiVersion.startswith("3."):
        return
    with zipfile.ZipFile(file) as archive:
        root = parse_xml(archive.read(DESCRIPTION_FILE), f"{file}: {DESCRIPTION_FILE}")
    if model.fmiVersion == "1.0":
        _complete_outputs(model, root)
        # FMI 1.0 for Co-Simulation, 4.3.1
        if model.coSimulation is not None:
            model.coSimulation.needsExecutionTool = root.find("Implementation/CoSimulation_Tool") is not None
            for stated in root.iterfind("Implementation/*/Capabilities"):
                for name in FMI1_CAPABILITIES:
                    setattr(model.coSimulation, name, _is_true(stated.get(name)))
    else:
        by_name = {element.get("name"): element for element in root.iterfind("ModelVariables/*")}
        for variable in model.modelVariables:
            # FMPy creates a variable for each alias
            element = by_name[variable.alias.name if variable.alias else variable.name]
            variable.intermediateUpdate = _is_true(element.get("intermediateUpdate"))
            variable.min, variable.max = variable.min or element.get("min"), variable.max or element.get("max")
            for name in CLOCK_ATTRIBUTES if variable.type == "Clock" else ():
                setattr(variable, name, element.get(name))


def _complete_outputs(model: Any, root: Any) -> None:
    """Add the output dependencies that an FMI 1.0 description declares, in FMPy's form for FMI 2.0."""
    by_name = {variable.name: variable for variable in model.modelVariables}
    for element in root.iterfind("ModelVariables/ScalarVariable"):
        stated = element.find("DirectDependency")
        if element.get("causality") == "output" and stated is not None:
            names = [name.text for name in stated.iterfind("Name")]
            model.outputs.append(
                Unknown(variable=by_name[element.get("name")], dependencies=[by_name[n] for n in names if n in by_name])
            )


def feedthrough(description: "FmuDescription") -> tuple[dict[str, frozenset[str]], frozenset[str]]:
    """Return the direct feedthrough of each FMU output, by ModelStructure (FMI 2.0.4, 2.2.8; FMI 3.0, 2.4.8).

    As (output name -> input names, outputs without declared dependencies, assumed to depend on all inputs).
    """
    inputs = frozenset(v.name for v in description.variables_of("input"))
    stated = {
        unknown.variable.name: frozenset(v.name for v in unknown.dependencies) & inputs
        for unknown in description.model.outputs
        if unknown.variable is not None and unknown.dependencies is not None
    }
    silent = frozenset(
        name for name, v in description.variables.items() if v.causality in ("output", "local") and name not in stated
    )
    return stated | dict.fromkeys(silent, inputs), silent


def _is_true(text: str | None) -> bool:
    return text in ("true", "1")


@dataclass(frozen=True)
class FmuDescription:
    """Description of an FMU that has passed all checks that need no binary; `model` is FMPy's.

    `version` is the FMI version 1, 2 or 3, and `identifier` the name of the binary. `platforms` are folders with
    binaries in the archive. `compiler` built its library on this machine, "" if the library came with the FMU.
    """

    path: Path
    sha256: str
    compiler: str
    version: int
    kind: Kind
    identifier: str
    platforms: tuple[str, ...]
    variables: dict[str, Variable]
    model: Any

    @property
    def interface(self) -> Any:
        """FMPy's interface description of the FMU for co-simulation or model exchange, the kind in use."""
        return _interface(self.model, self.kind)

    @property
    def standard(self) -> str:
        """FMI version of the FMU, for messages, with the kind if it is not co-simulation."""
        usual = self.kind == "co_simulation"
        return f"FMI {self.model.fmiVersion}" + ("" if usual else f" {KIND_NAMES[self.kind]}")

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """Kinds of interface that the FMU offers: co-simulation, model exchange."""
        return _kinds(self.model)

    def variables_of(self, causality: str) -> list[Variable]:
        """Return the FMU's numeric variables of a causality, such as "input", in the FMU's order."""
        return [v for v in self.variables.values() if v.causality == causality and v.kind >= 0]

    @property
    def parameters(self) -> list[Variable]:
        """Parameters of the FMU that an experiment may set, in the FMU's order."""
        causes = ("parameter", STRUCTURAL_PARAMETER)
        return [v for v in self.variables.values() if v.causality in causes and (v.kind >= 0 or v.is_text)]

    def settings(self, values: Mapping[str, Value]) -> Sequence[Setting]:
        """Check and convert values of FMU parameters and inputs, to be set before initialisation.

        InputRefused: an unknown name, a variable that cannot be set, a value out of range or not finite, a wrong number
        of values, or a missing file.
        """
        settable = {v.name: v for v in (*self.parameters, *self.variables_of("input"))}
        checked = []
        for name, given in values.items():
            if name not in settable:
                known = ", ".join(v.name for v in self.parameters) or "none"
                hint = nearest(name, settable, f"its parameters are {known}")
                raise InputRefused(f"{self.path}: no parameter '{name}'; {hint}")
            checked.append((settable[name], setting_value(self.path, settable[name], given)))
        return checked

    @property
    def prefix(self) -> str:
        """Prefix of FMI function and status names: "fmi", "fmi2" or "fmi3"."""
        return "fmi" if self.version == 1 else f"fmi{self.version}"

    def exported_name(self, function: str) -> str:
        """Return the name that an FMI function such as `DoStep` has in the binary; FMI 1.0 prepends the identifier."""
        return f"{self.identifier}_{self.prefix}{function}" if self.version == 1 else f"{self.prefix}{function}"

    @property
    def returns_early(self) -> bool:
        """Whether the FMU may return early from a step, if that is allowed."""
        if self.kind == "model_exchange":
            return False
        abilities = self.model.coSimulation
        return abilities.mightReturnEarlyFromDoStep or abilities.canReturnEarlyAfterIntermediateUpdate

    def with_sizes(self, values: Mapping[str, Value]) -> "FmuDescription":
        """Return the FMU description with array sizes for the structural parameters among `values`."""
        structure = {name: v.start for name, v in self.variables.items()}
        for name, value in values.items():
            if name in structure and self.variables[name].causality == STRUCTURAL_PARAMETER:
                if not isinstance(value, float) or not value.is_integer():
                    raise InputRefused(f"{self.path}: parameter {name} = {value}: expected a whole number")
                structure[name] = value
        variables = {name: v.with_size(self.path, structure) for name, v in self.variables.items()}
        return replace(self, variables=variables)

    @property
    def tolerance(self) -> float | None:
        """Relative solver tolerance that the FMU states (DefaultExperiment); None if not positive and finite."""
        stated = parse_number(getattr(self.model.defaultExperiment, "tolerance", None))
        return stated if 0.0 < stated < math.inf else None

    @property
    def needs_tool(self) -> bool:
        return bool(self.interface.needsExecutionTool)

    @property
    def tool_note(self) -> str:
        """Note that an FMU of PythonFMU needs Python as its execution tool; "" for other FMUs."""
        if not (self.needs_tool and (self.model.generationTool or "").startswith(PYTHON_FMU)):
            return ""
        return f"{NEEDS_TOOL}, which is Python; {PYTHON_FMU} builds it without that by --no-external-tool"

    @property
    def single_instance(self) -> bool:
        """Whether a process can contain only one instance of the FMU."""
        return bool(getattr(self.interface, "canBeInstantiatedOnlyOncePerProcess", False))

    def warnings(self) -> list[str]:
        """Return the findings of FMPy's validation of the FMU, only as warnings, as validators disagree."""
        from fmpy.validation import validate_fmu

        own = [self.tool_note] if self.tool_note else []
        return own + [" ".join(problem.split()) for problem in validate_fmu(str(self.path))]


_known: dict[tuple[Path, Kind | None], tuple[tuple[int, ...], FmuDescription]] = {}
"""Cache of `described`: file stamp and description."""


def described(file: Path, kind: Kind | None = None, lenient: bool = False) -> FmuDescription:
    """Read and check the description of an FMU; cached in the process while the file is unchanged.

    Without a `kind` it is co-simulation if offered, else model exchange; if `lenient`, it may need its authoring tool.
    InputRefused: not a complete zip file, an unreadable model description, neither co-simulation of FMI 1.0, 2.0 or 3.0
    nor model exchange of 2.0 or 3.0, another kind, a tool needed, or no binary for this platform.
    """
    # unlike Path.is_file, os.path.isfile does not raise for a name that is too long
    if not os.path.isfile(file):
        raise InputRefused(f"{file}: no such FMU")
    facts = file.stat()
    stamp = (facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns)
    known, description = _known.get((file, kind), (None, None))
    if description is None or known != stamp:
        description = _read_description(file, kind)
        # do not cache a file written just now, as its next change might get the same time stamp
        if time.time_ns() - max(facts.st_mtime_ns, facts.st_ctime_ns) > MIN_FILE_AGE:
            _known[file, kind] = stamp, description
    if description.needs_tool and not (lenient or description.tool_note):
        raise InputRefused(f"{file}: {NEEDS_TOOL}; export it self-contained, or see --lenient")
    return description


def _read_description(file: Path, kind: Kind | None) -> FmuDescription:
    names = entries(file)
    if names.get(DESCRIPTION_FILE, 0) > MAX_DESCRIPTION_SIZE:
        raise InputRefused(
            f"{file}: {DESCRIPTION_FILE} has {names[DESCRIPTION_FILE] / 1e6:.0f} MB; do not trust this file"
        )
    model = _model(file, names)
    version = model.fmiVersion
    if version not in ("1.0", "2.0") and not version.startswith("3."):
        raise InputRefused(f"{file}: FMI {version}; export it as FMI 2.0 or 3.0 for co-simulation")
    kind = _choose_kind(file, model, kind)
    major = int(version[0])
    identifier = _interface(model, kind).modelIdentifier
    binary = _binary_entry(major, identifier)
    # a folder entry is not a binary
    inside = [n for n in names if n.startswith("binaries/") and n.count("/") > 1 and not n.endswith("/")]
    platforms = sorted({PurePosixPath(n).parts[1] for n in inside})
    digest = sha256(file)
    made = None if binary in names else compiled_library(digest, binary)
    if binary not in names and made is None:
        raise InputRefused(f"{file}: {_missing_binary_phrase(file, names, model, binary, platforms)}")
    variables: dict[str, Variable] = {}
    for v in model.modelVariables:
        if not 0 <= v.valueReference < 1 << 32:
            raise InputRefused(
                f"{file}: variable '{v.name}' has the value reference {v.valueReference}; expected 0 .. {(1 << 32) - 1}"
            )
        if v.name in variables:
            first = variables[v.name].reference
            raise InputRefused(
                f"{file}: two variables are named '{v.name}' (value references {first} and {v.valueReference}); "
                "export it again with a name for each"
            )
        variables[v.name] = variable_of(v, model)
    return FmuDescription(
        path=file,
        sha256=digest,
        compiler=made.compiler if made else "",
        version=major,
        kind=kind,
        identifier=identifier,
        platforms=tuple(platforms),
        variables=variables,
        model=model,
    ).with_sizes({})


def build_binary(file: Path) -> CompiledLibrary | None:
    """Compile the sources of an FMU for this platform, if it lacks a binary for it; None if it has one."""
    names = entries(file)
    model = _model(file, names)
    binary = _binary_entry(int(model.fmiVersion[0]), _interface(model, _choose_kind(file, model, None)).modelIdentifier)
    return None if binary in names else compile_sources(file, sha256(file), model, binary)


def _interface(model: Any, kind: Kind) -> Any:
    return model.coSimulation if kind == "co_simulation" else model.modelExchange


def _kinds(model: Any) -> tuple[Kind, ...]:
    # model exchange of FMI 1.0, which has other functions, is not supported
    known: Mapping[Kind, str] = KIND_NAMES if model.fmiVersion != "1.0" else {"co_simulation": ""}
    return tuple(kind for kind in known if _interface(model, kind) is not None)


def _choose_kind(file: Path, model: Any, kind: Kind | None) -> Kind:
    """Return `kind` if the FMU offers it, or the first that it offers if `kind` is None; refuse other kinds."""
    kinds = _kinds(model)
    if not kinds:
        other = "" if model.fmiVersion == "1.0" else " and model exchange"
        raise InputRefused(f"{file}: FMI {model.fmiVersion} without co-simulation{other}; export it for co-simulation")
    if kind is not None and kind not in kinds:
        raise InputRefused(
            f'{file}: offers {KIND_NAMES[kinds[0]]} alone; remove kind = "{kind}", or export it for {KIND_NAMES[kind]}'
        )
    return kind or kinds[0]


def _binary_entry(major: int, identifier: str) -> str:
    return f"binaries/{_platform(major)}/{identifier}{sharedLibraryExtension}"


def _missing_binary_phrase(
    file: Path, names: Collection[str], model: Any, binary: str, platforms: Sequence[str]
) -> str:
    place = PurePosixPath(binary)
    others = [PurePosixPath(n).name for n in names if n.startswith(f"{place.parent}/") and not n.endswith("/")]
    if others:
        return (
            f"its binary for this platform is {', '.join(others)}; by its modelIdentifier it has to be called "
            f"{place.name}. Export it again"
        )
    cure = f"Export it for {place.parent.name}"
    if has_sources(names, source_sets(model, place.stem)):
        cure = f"It brings its sources: twin drive info {file} --compile builds them, once"
    return f"no binary for this platform ({binary}); it has {', '.join(platforms) or 'none'}. {cure}"


def _platform(major: int) -> str:
    if major < 3:
        return platform
    system = {"linux": "linux", "darwin": "darwin", "win32": "windows"}.get(sys.platform, sys.platform)
    processor = {"AMD64": "x86_64", "arm64": "aarch64"}.get(machine.machine(), machine.machine())
    return f"{processor}-{system}"


def _model(file: Path, names: Collection[str]) -> Any:
    if DESCRIPTION_FILE not in names:
        packed = next((name for name in names if PurePosixPath(name).name == DESCRIPTION_FILE), "")
        if not packed:
            raise InputRefused(f"{file}: no {DESCRIPTION_FILE} inside; this is not an FMU")
        raise InputRefused(f"{file}: its {DESCRIPTION_FILE} is packed as '{packed}'; pack it again without that folder")
    try:
        model = read_model_description(str(file), validate=False)
        complete_model(model, file)
    # FMPy raises bare Exception, and lxml its own exceptions
    except Exception as problem:
        raise InputRefused(f"{file}: {DESCRIPTION_FILE} cannot be read: {_read_error(file, problem)}") from None
    identified = all(interface.modelIdentifier for interface in (model.coSimulation, model.modelExchange) if interface)
    if not identified or model.guid is None:
        missing = ("instantiationToken" if model.fmiVersion[0] == "3" else "guid") if identified else "modelIdentifier"
        raise InputRefused(f"{file}: {DESCRIPTION_FILE} has no {missing}; export it again")
    return model


def _read_error(file: Path, problem: Exception) -> str:
    """Return the reason why FMPy cannot read a model description: the place of an XML error, or of a missing part."""
    if type(problem) is Exception:
        # an error message of FMPy itself
        return str(problem)
    try:
        root = parse_xml(read_entry(file, DESCRIPTION_FILE, MAX_DESCRIPTION_SIZE), DESCRIPTION_FILE)
    except InputRefused as broken:
        return str(broken).removeprefix(f"{DESCRIPTION_FILE}: ")
    if not root.get("fmiVersion"):
        return f"<{root.tag}> has no fmiVersion"
    count = len(root.findall("ModelVariables/*"))
    for element in root.iter():
        for name in (*INDEX_ATTRIBUTES, "valueReference"):
            for word in (element.get(name) or "").split():
                stated = f'<{element.tag} {name}="{element.get(name)}">'
                if not word.isdecimal():
                    return f"{stated}: expected whole numbers"
                if name in INDEX_ATTRIBUTES and root.get("fmiVersion") == "2.0" and not 1 <= int(word) <= count:
                    return f"{stated}: there are {count} variables"
    for number, variable in enumerate(root.findall("ModelVariables/*"), start=1):
        place = f"<{variable.tag}> {number} of {count}, '{variable.get('name', '')}',"
        for name in ("name", "valueReference"):
            if variable.get(name) is None:
                return f"{place} has no {name}"
        if variable.tag == "ScalarVariable" and not any(child.tag in SCALAR_TYPES for child in variable):
            return f"{place} has no type; expected one of {', '.join(SCALAR_TYPES)}"
    known = {variable.get("valueReference") for variable in root.findall("ModelVariables/*")}
    for element in root.findall("ModelStructure//*"):
        if element.tag == "Unknown" and element.get("index") is None:
            return "an <Unknown> of the model structure has no index"
        reference = element.get("valueReference")
        if reference is not None and reference not in known:
            return f'<{element.tag} valueReference="{reference}">: no variable has this value reference'
    return f"FMPy stops with {type(problem).__name__}: {problem}; validate it with the schema of its standard"


def clocks(description: FmuDescription) -> list[Any]:
    """Return the input and output clocks of an FMU (FMPy's variables), at most `MAX_CLOCKS`."""
    found = [v for v in description.model.modelVariables if v.type == "Clock" and v.causality in ("input", "output")]
    if len(found) > MAX_CLOCKS:
        raise InputRefused(f"{description.path}: {len(found)} clocks; expected at most {MAX_CLOCKS}")
    return found


def clock_phrase(clock: Any) -> str:
    """Describe when a clock ticks, from its declaration in the model description."""
    if clock.causality == "output":
        return "ticked by the FMU"
    if clock.intervalVariability == "triggered":
        return "in every step"
    interval, shift = stated_interval(clock)
    if math.isnan(interval):
        return f"{clock.intervalVariability}, determined by the FMU while it runs"
    return f"every {1e3 * interval:g} ms" + (f" from {1e3 * shift:g} ms on" if shift else "")


def stated_interval(clock: Any) -> tuple[float, float]:
    """Return the declared (interval, shift) of an FMU's clock (s); the interval is NaN if not declared."""
    resolution = parse_number(clock.resolution)
    if clock.intervalDecimal is not None or math.isnan(resolution):
        return parse_number(clock.intervalDecimal), parse_number(clock.shiftDecimal or "0")
    scale = 1.0 / resolution if resolution > 0.0 else math.nan
    return parse_number(clock.intervalCounter) * scale, parse_number(clock.shiftCounter or "0") * scale


def capability_rows(description: FmuDescription) -> list[tuple[str, str]]:
    """Return (topic, description) of the FMU's unusual stepping capabilities, for messages."""
    if description.kind == "model_exchange":
        return []
    rows, its = [], description.model.coSimulation
    if not its.canHandleVariableCommunicationStepSize:
        stated = stated_step(description)
        wish = f"; it prefers {1e3 * stated:g} ms" if stated > 0.0 else ""
        rows.append(("steps", f"steps of one size only{wish}"))
    if its.hasEventMode or description.returns_early:
        modes = ["event mode"] * its.hasEventMode + ["may return early"] * description.returns_early
        rows.append(("events", ", ".join(modes)))
    rows += [("clock", f"{clock.name}, {clock_phrase(clock)}") for clock in clocks(description)]
    within = its.providesIntermediateUpdate and any(v.intermediate for v in description.variables_of("input"))
    if its.canInterpolateInputs or within:
        rows.append(("inputs", 'taken as lines over a step with [cosim] inputs = "linear"'))
    return rows


def refuse_step(description: FmuDescription, tick: float, substeps: int) -> None:
    """Check that an FMU accepts `substeps` equal steps per `tick` (s).

    FMI 3.0 recommends multiples of fixedInternalStepSize; it is enforced only for FMUs that accept no variable step.
    The step size that FMI 1.0 and 2.0 state is only a preference.
    """
    # the solver chooses the steps of model exchange
    if description.kind == "model_exchange":
        return
    abilities, step = description.model.coSimulation, tick / substeps
    fixed = parse_number(abilities.fixedInternalStepSize)
    if description.version < 3 or abilities.canHandleVariableCommunicationStepSize or not 0.0 < fixed < math.inf:
        return
    count = step / fixed
    if round(count) >= 1 and abs(count - round(count)) < STEP_TOLERANCE:
        return
    whole = tick / fixed
    fitting = [
        n for n in range(1, 1001) if round(whole / n) >= 1 and abs(whole / n - round(whole / n)) < STEP_TOLERANCE
    ]
    cure = f"substeps = {max(fitting)}" if fitting else f"tick_ms = {1e3 * fixed * max(1, math.ceil(whole)):g}"
    raise InputRefused(
        f"{description.path}: has a fixed step of {1e3 * fixed:g} ms inside and takes multiples of it only "
        f"(fixedInternalStepSize, canHandleVariableCommunicationStepSize); its step here is {1e3 * step:g} ms: "
        f"choose {cure}"
    )


def stated_step(description: FmuDescription) -> float:
    """Return the internal step size of an FMU, else the preferred one (s); NaN if not stated."""
    # FMUs for model exchange have no internal step
    fixed = parse_number(getattr(description.interface, "fixedInternalStepSize", None))
    preferred = parse_number(getattr(description.model.defaultExperiment, "stepSize", None))
    return preferred if math.isnan(fixed) else fixed
