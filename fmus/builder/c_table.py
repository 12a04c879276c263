"""The C side of drive.toml: the struct of variables and the table of their names, starts and bounds."""

import math

from .drive import Drive, Variable


def variables_header(drive: Drive) -> str:
    """Text of variables.h: GUID, N_VARIABLES and the union `Variables` (by name and by value reference)."""
    members = "\n".join(f"        double {variable.name};" for variable in drive.variables)
    return f"""/* Generated from {drive.name}/drive.toml. */
#ifndef VARIABLES_H
#define VARIABLES_H

#define GUID "{drive.guid}"
#define N_VARIABLES {len(drive.variables)}

typedef union {{
    struct {{
{members}
    }};
    double at[N_VARIABLES];
}} Variables;

#endif
"""


def variables_table(drive: Drive) -> str:
    """Text of variables.c: the rows that setting and resetting consult; FMI 3.0 has a column more, the type."""
    rows = "\n".join(f"    {_row(variable, drive.fmi)}," for variable in drive.variables)
    return f"""/* Generated from {drive.name}/drive.toml. */
#include "slave.h"

#include <math.h>

const Variable variables[N_VARIABLES] = {{
{rows}
}};
"""


def _row(variable: Variable, fmi: str) -> str:
    is_input = "true" if variable.causality == "input" else "false"
    is_whole = "true" if variable.is_whole else "false"
    low, high = (_number(value) for value in variable.bounds)
    kind = f"{variable.type}, " if fmi == "3.0" else ""
    return f'{{"{variable.name}", {kind}{is_input}, {is_whole}, {float(variable.start)!r}, {low}, {high}}}'


def _number(value: float) -> str:
    """The C literal of `value`, which may be infinite."""
    return f"{'-' * (value < 0)}INFINITY" if math.isinf(value) else repr(value)
