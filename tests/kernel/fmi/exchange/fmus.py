"""Model-exchange FMUs for tests and benchmarks, compiled from exchange.c around motor.c or servo.c."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

HERE = Path(__file__).parent
PLATFORMS = {2: "linux64", 3: "x86_64-linux"}
UNITS = {
    "rad": 'rad="1"',
    "rad/s": 'rad="1" s="-1"',
    "N.m": 'kg="1" m="2" s="-2"',
    "A": 'A="1"',
}
MOTOR = ("R", "L", "k", "J", "b", "kp", "i_max", "stop", "bounce", "switch_every", "fault", "fault_at", "asks")
SERVO = ("T_m", "droop", "omega_max", "alpha_max", "tau_max", "J_m")
FAULTS = {
    name: number
    for number, name in enumerate(
        ("derivative is NaN", "event without end", "states grow", "indicators flicker", "event in the past",
         "indicator is NaN", "event now, for ever", "derivatives fail", "terminate", "too many states",
         "no nominal values"), start=1,
    )
}  # fmt: skip
"""The values of the motor's parameter `fault`."""
STATES = {"motor": ("theta_m", "omega_m", "current"), "servo": ("theta_m", "omega_m")}
INDICATORS = {"motor": 2, "servo": 0}
FIRST_DERIVATIVE, FIRST_INDICATOR = 24, 28
"""Value references of variables that nobody asks for."""


class NoCompiler(Exception):
    """There is none on this machine, or it makes no libraries that this machine loads."""


Variable = tuple[str, int, str, str, str]
"""Name, value reference, causality, unit, start."""


def exchange_fmu(folder: Path, name: str, fmi: int, states: int | None = None) -> Path:
    """`folder`/`name`_`fmi`.fmu: the motor, or the servo.

    Args:
        states: how many modelDescription.xml says it has, if not the truth.

    Raises:
        NoCompiler: it cannot be made here.
    """
    target = folder / f"{name}_{fmi}{'' if states is None else f'_{states}'}.fmu"
    library = folder / f"{name}_{fmi}.so"
    if not library.exists():
        _compile(name, fmi, library)
    with zipfile.ZipFile(target, "w") as archive:
        archive.writestr("modelDescription.xml", _description(name, fmi, states))
        archive.write(library, f"binaries/{PLATFORMS[fmi]}/{name}.so")
    return target


def _compile(name: str, fmi: int, library: Path) -> None:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not sys.platform.startswith("linux"):
        raise NoCompiler("compiles a drive: needs Linux and a C compiler")
    macros = [f"-DFMI={fmi}", f'-DMODEL="{name}.c"']
    command = [compiler, "-shared", "-fPIC", "-O2", *macros, str(HERE / "exchange.c"), "-lm", "-o", str(library)]
    subprocess.run(command, check=True)


def _variables(name: str) -> list[Variable]:
    units = {"theta_m": "rad", "omega_m": "rad/s", "current": "A"}
    found: list[Variable] = [("omega_ref", 0, "input", "rad/s", "0.0"), ("tau_load", 1, "input", "N.m", "0.0")]
    found += [(state, 2 + i, "output", units[state], "0.0") for i, state in enumerate(STATES[name])]
    parameters = MOTOR if name == "motor" else SERVO
    found += [(p, len(found) + i, "parameter", "", "0.0") for i, p in enumerate(parameters)]
    return [*found, ("updates", len(found), "local", "", "")]


def _description(name: str, fmi: int, states: int | None) -> str:
    variables = _variables(name)
    count = len(STATES[name]) if states is None else states
    hidden = [(f"der_{i}", FIRST_DERIVATIVE + i) for i in range(min(count, 4))]
    indicators = [(f"z_{i}", FIRST_INDICATOR + i) for i in range(INDICATORS[name])]
    units = "".join(f'<Unit name="{unit}"><BaseUnit {base}/></Unit>' for unit, base in UNITS.items())
    if fmi == 2:
        body = "".join(_real(*variable) for variable in variables)
        body += "".join(_real(n, vr, "local", "", "") for n, vr in hidden)
        first = len(variables) + 1
        unknowns = "".join(f'<Unknown index="{first + i % len(hidden)}"/>' for i in range(count))
        outputs = "".join(f'<Unknown index="{3 + i}"/>' for i in range(len(STATES[name])))
        return (
            f'<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{{exchange}}" '
            f'numberOfEventIndicators="{len(indicators)}"><ModelExchange modelIdentifier="{name}" '
            f'canGetAndSetFMUstate="true"/><UnitDefinitions>{units}</UnitDefinitions><ModelVariables>{body}'
            f"</ModelVariables><ModelStructure><Outputs>{outputs}</Outputs><Derivatives>{unknowns}</Derivatives>"
            "</ModelStructure></fmiModelDescription>"
        )
    body = '<Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>'
    body += "".join(_float(*variable) for variable in variables)
    body += "".join(_float(n, vr, "local", "", "") for n, vr in (*hidden, *indicators))
    outputs = "".join(f'<Output valueReference="{2 + i}"/>' for i in range(len(STATES[name])))
    unknowns = "".join(f'<ContinuousStateDerivative valueReference="{vr}"/>' for _, vr in hidden)
    unknowns += "".join(f'<EventIndicator valueReference="{vr}"/>' for _, vr in indicators)
    return (
        f'<fmiModelDescription fmiVersion="3.0" modelName="{name}" instantiationToken="{{exchange}}">'
        f'<ModelExchange modelIdentifier="{name}" canGetAndSetFMUState="true" needsCompletedIntegratorStep="true"/>'
        f"<UnitDefinitions>{units}</UnitDefinitions><ModelVariables>{body}</ModelVariables>"
        f"<ModelStructure>{outputs}{unknowns}</ModelStructure></fmiModelDescription>"
    )


def _real(name: str, reference: int, causality: str, unit: str, start: str) -> str:
    known, told = _told(name, reference, causality, unit, start)
    return f"<ScalarVariable {known}><Real{told}/></ScalarVariable>"


def _float(name: str, reference: int, causality: str, unit: str, start: str) -> str:
    known, told = _told(name, reference, causality, unit, start)
    return f"<Float64 {known}{told}/>"


def _told(name: str, reference: int, causality: str, unit: str, start: str) -> tuple[str, str]:
    """Attributes of a variable, and of its type."""
    variability = "tunable" if causality == "parameter" else "continuous"
    told = (f' unit="{unit}"' if unit else "") + (f' start="{start}"' if start and causality == "input" else "")
    return f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}"', told
