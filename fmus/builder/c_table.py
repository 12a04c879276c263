"""The C side of drive.toml: the struct of variables and the table of their names, starts and bounds."""

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
    """Text of variables.c: the rows that fmi2SetReal and fmi2Reset consult."""
    rows = "\n".join(f"    {_row(variable)}," for variable in drive.variables)
    return f"""/* Generated from {drive.name}/drive.toml. */
#include "slave.h"

#include <math.h>

const Variable variables[N_VARIABLES] = {{
{rows}
}};
"""


def _row(variable: Variable) -> str:
    is_input = "true" if variable.causality == "input" else "false"
    low = "-INFINITY" if variable.min is None else repr(float(variable.min))
    high = "INFINITY" if variable.max is None else repr(float(variable.max))
    return f'{{"{variable.name}", {is_input}, {float(variable.start)!r}, {low}, {high}}}'
