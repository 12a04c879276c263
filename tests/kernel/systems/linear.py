"""FMUs of linear equations, compiled from linear.c; a system of them has a monolithic solution."""

import math
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

HERE = Path(__file__).parent
STATES, ENDS = 4, 2
INPUTS, OUTPUTS = ("u", "w"), ("y", "v")
STEPPED, RATES = 49, 50
"""Value references of linear.c."""


@dataclass(frozen=True)
class Linear:
    """dx/dt = a x + b u, y = c x + d u, from `x0`; what is not given is 0.

    Attributes:
        kinds: that the FMU offers.
        state: whether it can be set back.
        stated: whether it says on which inputs its outputs depend.
        experiment: attributes of its DefaultExperiment.
        ends_at: when it asks to end (s).
        lacking: whether fmi2CancelStep is not there.
        modes: whether there is a parameter `mode`, an enumeration that does nothing.
    """

    a: Sequence[Sequence[float]] = ()
    b: Sequence[Sequence[float]] = ()
    c: Sequence[Sequence[float]] = ()
    d: Sequence[Sequence[float]] = ()
    x0: Sequence[float] = ()
    kinds: Sequence[str] = ("CoSimulation", "ModelExchange")
    state: bool = True
    stated: bool = True
    experiment: str = 'stepSize="0.01"'
    ends_at: float | None = None
    lacking: bool = False
    modes: bool = False

    @property
    def states(self) -> int:
        return max(len(self.a), len(self.x0))

    def matrix(self, name: str, rows: int, columns: int) -> np.ndarray:
        """One of the four as it is in the FMU, filled up with zeros."""
        found = np.zeros((rows, columns))
        given = np.atleast_2d(np.array(getattr(self, name), dtype=float))
        if given.size:
            found[: given.shape[0], : given.shape[1]] = given
        return found

    def fmu(self, file: Path) -> Path:
        """Made there; skips without a compiler, but not on CI, which has one."""
        library = _library(file.parent, self.lacking)
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("modelDescription.xml", self._description())
            archive.write(library, "binaries/linux64/linear.so")
        return file

    def _description(self) -> str:
        d = self.matrix("d", ENDS, ENDS)
        lines, outputs = [], ""
        for i, name in enumerate(INPUTS):
            lines.append(_variable(name, i, 'causality="input"', 'start="0"'))
        for i, name in enumerate(OUTPUTS):
            lines.append(_variable(name, 2 + i, 'causality="output"', ""))
            depends = f'dependencies="{" ".join(str(j + 1) for j in range(ENDS) if d[i, j])}"' if self.stated else ""
            outputs += f'<Unknown index="{3 + i}" {depends}/>'
        for i in range(self.states):
            lines.append(_variable(f"x{i}", 4 + i, 'causality="local" initial="calculated"', ""))
        rates = "".join(f'<Unknown index="{len(lines) + 1 + i}"/>' for i in range(self.states))
        for i in range(self.states):
            lines.append(
                _variable(f"dx{i}", RATES + i, 'causality="local" initial="calculated"', f'derivative="{5 + i}"')
            )
        lines.append(_variable("steps", STEPPED, 'causality="local"', ""))
        numbers = [*np.pad(np.array(self.x0, dtype=float), (0, STATES - len(self.x0)))]
        for name, rows, columns in (("a", STATES, STATES), ("b", STATES, ENDS), ("c", ENDS, STATES), ("d", ENDS, ENDS)):
            numbers += [*self.matrix(name, rows, columns).ravel()]
        guid = " ".join(
            repr(float(number)) for number in (*numbers, math.inf if self.ends_at is None else self.ends_at)
        )
        types, experiment = "", f"<DefaultExperiment {self.experiment}/>"
        if self.modes:
            items = '<Item name="slow" value="1"/><Item name="fast" value="2"/>'
            types = f'<SimpleType name="M"><Enumeration>{items}</Enumeration></SimpleType>'
            types = f"<TypeDefinitions>{types}</TypeDefinitions>"
            lines.append(
                '<ScalarVariable name="mode" valueReference="0" causality="parameter" variability="fixed">'
                '<Enumeration declaredType="M" start="1"/></ScalarVariable>'
            )
        can = 'canGetAndSetFMUstate="true" canSerializeFMUstate="true"' if self.state else ""
        varies = 'canHandleVariableCommunicationStepSize="true"'
        kinds = "".join(
            f'<{kind} modelIdentifier="linear" {can} {varies if kind == "CoSimulation" else ""}/>'
            for kind in sorted(self.kinds, reverse=True)
        )
        return (
            f'<fmiModelDescription fmiVersion="2.0" modelName="linear" guid="{guid}" '
            f'numberOfEventIndicators="0">{kinds}'
            f"{types}{experiment}<ModelVariables>{''.join(lines)}</ModelVariables>"
            f"<ModelStructure><Outputs>{outputs}</Outputs>"
            f"{f'<Derivatives>{rates}</Derivatives>' if rates else ''}</ModelStructure></fmiModelDescription>"
        )


def _variable(name: str, reference: int, known: str, told: str) -> str:
    return f'<ScalarVariable name="{name}" valueReference="{reference}" {known}><Real {told}/></ScalarVariable>'


def _library(folder: Path, lacking: bool) -> Path:
    library = folder / f"linear{'_lacking' if lacking else ''}.so"
    if not library.exists():
        compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
        if compiler is None or not sys.platform.startswith("linux"):
            assert "CI" not in os.environ, "this test compiles an FMU and CI has to have a C compiler"
            pytest.skip("compiles an FMU: needs Linux and a C compiler")
        command = [compiler, "-shared", "-fPIC", "-O2", *(["-DLACKING"] if lacking else []), str(HERE / "linear.c")]
        subprocess.run([*command, "-lm", "-o", str(library)], check=True)
    return library


Wire = tuple[str, str]


def monolith(parts: dict[str, Linear], wires: Sequence[Wire], t: np.ndarray) -> dict[str, np.ndarray]:
    """The exact outputs of parts joined by wires ("a.y", "b.u"), loops solved, by "part.output".

    Args:
        parts: by name.
        wires: between them.
        t: instants from 0 on, one as far from the next as the others (times,), s.
    """
    names = list(parts)
    n, m = STATES * len(names), ENDS * len(names)
    a, b, c, d = np.zeros((n, n)), np.zeros((n, m)), np.zeros((m, n)), np.zeros((m, m))
    for k, part in enumerate(parts.values()):
        x, e = slice(STATES * k, STATES * (k + 1)), slice(ENDS * k, ENDS * (k + 1))
        a[x, x], b[x, e] = part.matrix("a", STATES, STATES), part.matrix("b", STATES, ENDS)
        c[e, x], d[e, e] = part.matrix("c", ENDS, STATES), part.matrix("d", ENDS, ENDS)
    join = np.zeros((m, m))
    for source, target in wires:
        (from_, output), (to, entry) = source.split("."), target.split(".")
        join[ENDS * names.index(to) + INPUTS.index(entry), ENDS * names.index(from_) + OUTPUTS.index(output)] = 1.0
    # y = c x + d u, u = join y
    y = np.linalg.solve(np.eye(m) - d @ join, c)
    whole = a + b @ join @ y
    x0 = np.concatenate([np.pad(np.array(p.x0, dtype=float), (0, STATES - len(p.x0))) for p in parts.values()])
    now, on, states = x0, expm(whole * (t[1] - t[0])), []
    for _ in t:
        states.append(now)
        now = on @ now
    rows = np.array(states) @ y.T
    return {
        f"{name}.{output}": rows[:, ENDS * k + i] for k, name in enumerate(names) for i, output in enumerate(OUTPUTS)
    }
