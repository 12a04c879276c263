"""What an FMU is given before it is initialised: facts of the run, and numbers, arrays, text and files by name."""

import hashlib
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twin.kernel.archive import sha256
from twin.kernel.errors import InputRefused
from twin.kernel.files import read_bytes
from twin.kernel.fmi.variable import Conversion, Variable, meant, valued
from twin.kernel.ssp.parameters import ParameterValue, UnitDefinition


class Setup(NamedTuple):
    """What an FMU is told of the run before it is initialised.

    Attributes:
        tolerance: relative, of its solver; None: nothing is said.
        stop: time of the last step's end (s); None: nothing is said, and some FMUs then end where they like to.
        step: length of its steps (s), in which its clocks tick; None: not known, and clocks are refused.
        ramped: whether those of its inputs that can be are given as lines over a step.
        waiting: whether it is left in initialisation mode, where what others come to can still be set, until `begin`.
    """

    tolerance: float | None = None
    stop: float | None = None
    step: float | None = None
    ramped: bool = False
    waiting: bool = False


Value = float | str | Sequence[float] | Sequence[str]
"""Of a parameter as an experiment says it: an array takes one value for all elements, or one for each."""

Setting = tuple[Variable, float | np.ndarray | list[str] | list[bytes]]
"""A variable and what to set it to, in its own unit; an array takes one value for all elements or one for each."""

FILE = "file:"
"""Before the path of a file, for text that names one and for a Binary that holds what is in it."""

MOST_BYTES = 64 << 20
"""Of a file that is handed over as a Binary."""


class FilePath(str):
    """Text that is the path of a file."""


def told(value: float | np.ndarray | list[str] | list[bytes]) -> Any:
    """What a variable is set to, as JSON has it: a file or its content by SHA-256, and not by where it lies."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if not isinstance(value, list):
        return value
    texts = [
        f"{len(v)} bytes, sha256 {hashlib.sha256(v).hexdigest()}"
        if isinstance(v, bytes)
        else f"{Path(v).name}, sha256 {sha256(Path(v))}"
        if isinstance(v, FilePath)
        else v
        for v in value
    ]
    return texts[0] if len(texts) == 1 else texts


def set_to(file: Path, variable: Variable, value: Value) -> float | np.ndarray | list[str] | list[bytes]:
    """`value` as `variable` of the FMU `file` takes it.

    Raises:
        InputRefused: it is of another type, out of range, none of an enumeration or not finite, there are too many
            or too few, no such file.
    """
    where = f"{file}: parameter {variable.name}"
    given: list[float | str] = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    if len(given) not in (1, variable.size):
        raise InputRefused(f"{where}: {len(given)} values; expected {variable.size}, or one for all of them")
    if variable.is_text:
        texts = [_text(where, text) for text in given] * (variable.size // len(given))
        if variable.type == "String":
            return [_path(where, text) for text in texts]
        return [_bytes(where, text) for text in texts]
    numbers = [_number(where, variable, number) for number in given]
    return numbers[0] if len(numbers) == 1 else np.array(numbers)


def _number(where: str, variable: Variable, value: float | str) -> float:
    value = valued(where, variable.items, value)
    low = variable.low if not math.isnan(variable.low) else -math.inf
    high = variable.high if not math.isnan(variable.high) else math.inf
    if not (low <= value <= high and math.isfinite(value)):
        raise InputRefused(f"{where} = {value:g}: expected {low:g} .. {high:g} {variable.unit}".rstrip())
    return float(value)


def _text(where: str, value: object) -> str:
    if not isinstance(value, str):
        raise InputRefused(f'{where} = {value}: expected text, or "{FILE}NAME" for a file')
    return value


def _path(where: str, text: str) -> str:
    if not text.startswith(FILE):
        return text
    path = FilePath(text.removeprefix(FILE))
    if not os.path.isfile(path):
        raise InputRefused(f"{where}: {path}: no such file")
    return path


def _bytes(where: str, text: str) -> bytes:
    if not text.startswith(FILE):
        return text.encode()
    return read_bytes(Path(text.removeprefix(FILE)), MOST_BYTES)


def given_values(value: ParameterValue, where: str) -> list[float] | list[str]:
    """What a parameter set gives, at least one value.

    Raises:
        InputRefused: it is binary, nothing, or text that names a file of this machine where an experiment says it.
    """
    if value.type == "Binary" or not value.values:
        what = "binary, which is not read here" if value.values else "given no value"
        raise InputRefused(f"{where}: {value.name} is {what}")
    if any(isinstance(one, str) and one.startswith(FILE) for one in value.values):
        raise InputRefused(
            f"{where}: {value.name} begins with '{FILE}'; a parameter set may not name files of this machine"
        )
    return list(value.values)  # type: ignore[return-value]


def stated_unit(unit: str, definitions: Sequence[UnitDefinition]) -> Conversion | None:
    """How values in `unit` become SI by the `definitions` of an SSP file; None: it does not define that unit."""
    for one in definitions:
        if one.name == unit:
            return meant(unit, Conversion(one.dimension, one.factor, one.offset))
    return None


def stop_time(ticks: int | None, tick: float, substeps: int) -> float | None:
    """When the last step ends (s): the run's duration, or what t + h of that step is rounded to, if that is later."""
    if ticks is None:
        return None
    step = tick / substeps
    return max(ticks * tick, (ticks * substeps - 1) * step + step)
