"""A layout as C: what `part.h` declares."""

import math
import struct
from collections.abc import Iterable, Sequence

from twin.studies.build.layout import Layout, Row, Variable

STATUS = {"plant": "left the workspace, a leg cannot reach the platform"}
"""What status 2 means of a component whose own words are of this moment."""


def sizes(layout: Layout, variables: Sequence[Variable], guid: str, tick: float) -> str:
    """The header `sizes.h`."""
    numbers = {
        "N_VARIABLES": len(variables),
        "N_VALUES": layout.values,
        "N_PLACES": len(layout.places),
        "N_POINTERS": len(layout.pointers),
        "N_COMPONENTS": len(layout.rows),
        "N_U": len(layout.sources),
        "MEMORY_BYTES": len(layout.image),
    }
    lines = [f'#define GUID "{guid}"', f"#define TICK {_number(tick)}"]
    return "\n".join([*lines, *(f"#define {name} {number}" for name, number in numbers.items()), ""])


def tables(layout: Layout, variables: Sequence[Variable]) -> str:
    """The source `tables.c`."""
    steps = {row.symbol for row in layout.rows}
    doubles = struct.unpack(f"<{len(layout.image) // 8}Q", layout.image)
    return "\n".join(
        [
            '#include "part.h"',
            *(f"DECLARE_STEP({symbol});" for symbol in sorted(steps)),
            _array("Variable", "variables[N_VARIABLES]", map(_variable, variables)),
            _array("double", "start_values[N_VALUES]", (_number(x) for v in layout.variables for x in v.start)),
            _array(
                "Place", "places[N_PLACES + 1]",
                (
                    f"{{{p.value}, {p.offset}, {_number(p.factor)}, {_number(p.divisor)}, {_number(p.times)}}}"
                    for p in layout.places
                ),
            ),
            _array("Pointer", "pointers[N_POINTERS + 1]", (f"{{{field}, {at}}}" for field, at in layout.pointers)),
            _array("Component", "components[N_COMPONENTS]", map(_component, layout.rows)),
            _array("unsigned", "sources[N_U + 1]", map(str, layout.sources)),
            # whole numbers: a double that is none would not survive as text
            _array("uint64_t", "image[(MEMORY_BYTES + 7) / 8]", (f"{word}u" for word in doubles)),
            "",
        ]
    )  # fmt: skip


def _array(kind: str, declared: str, values: Iterable[str]) -> str:
    inside = ",\n    ".join(values) or "0"
    return f"static const {kind} {declared} = {{\n    {inside}}};"


def _variable(variable: Variable) -> str:
    above, at_least, below, at_most = variable.limits
    lower = next((x for x in (above, at_least) if x is not None), -math.inf)
    upper = next((x for x in (below, at_most) if x is not None), math.inf)
    return (
        f'{{"{variable.name}", {variable.kind.upper()}, {variable.first}, {len(variable.start)}, {_number(lower)}, '
        f"{_number(upper)}, {int(above is not None)}, {int(below is not None)}}}"
    )


def _component(row: Row) -> str:
    n_u = sum(port.size for port in row.component.inputs)
    name = row.component.name
    status = f'"{STATUS.get(name) or row.component.explain(2)}"'
    return (
        f'{{"{name}", STEP({row.symbol}), {row.period}, {row.memory}, {row.u}, {n_u}, {row.y}, {row.y_size}, '
        f"{int(row.component.finite)}, {status}}}"
    )


def _number(value: float) -> str:
    """`value` as C reads exactly it."""
    if math.isinf(value):
        return "-HUGE_VAL" if value < 0 else "HUGE_VAL"
    return float(value).hex()
