"""What can be changed in the source, and a draw from it."""

import ast
import random
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOMS = (
    "robot/mechanism", "robot/plant", "robot/controller", "robot/monitor", "robot/drive", "robot/faults", "kernel/fmi",
    "studies/paper", "studies/metrics",
)  # fmt: skip
"""Folders of twin/ whose files are changed."""
FORMER = ("robot", "plant", "controller", "monitor", "drive", "faults", "studies/paper", "studies/metrics")
"""Those of commits in which twin/ had no kernel, whose draws go on."""
COMPILERS = ("njit", "step_function", "entry")
"""Decorators of functions that are compiled."""

ARITHMETIC = ("Add", "Sub", "Mul", "Div")
ORDER = ("Eq", "NotEq", "Lt", "LtE", "Gt", "GtE")


def _is_drawn_from(operator: str) -> bool:
    """Whether a change by `operator` may go unnoticed: shifts and bits of floats fail by themselves."""
    kind, *pair = operator.removeprefix("core/").split("_")
    return {
        "ReplaceBinaryOperator": all(name in ARITHMETIC for name in pair),
        "ReplaceComparisonOperator": all(name in ORDER for name in pair),
        "ReplaceUnaryOperator": pair in (["USub", "UAdd"], ["Delete", "Not"]),
        "AddNot": True,
        "ReplaceTrueWithFalse": True,
        "ReplaceFalseWithTrue": True,
        "ReplaceAndWithOr": True,
        "ReplaceOrWithAnd": True,
        "ReplaceBreakWithContinue": True,
        "NumberReplacer": True,
        "ZeroIterationForLoop": True,
    }.get(kind, False)


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Attributes:
        file: below the repository.
        operator: name of the change, as cosmic-ray has it.
        occurrence: which of the places in the file that `operator` can change.
        line: of that place.
        is_compiled: whether the place is in a compiled function.
        statement: lines of the statement there; of one that has others inside, those before them.
    """

    file: Path
    operator: str
    occurrence: int
    line: int
    is_compiled: bool
    statement: range

    @property
    def room(self) -> str:
        """Which of `ROOMS`, or of `FORMER`, `file` is in."""
        return next(room for room in (*ROOMS, *FORMER) if self.file.is_relative_to(Path("twin", room)))

    def applied(self, source: str) -> str:
        """`source` with the change.

        Raises:
            ValueError: there is no such place in it.
        """
        changed = mutate_code(source, get_operator(self.operator)(), self.occurrence)
        if changed is None:
            raise ValueError(f"{self.file}: no place {self.occurrence} for {self.operator}")
        return str(changed)


def possible_mutants(root: Path) -> list[Mutant]:
    """Every change that can be drawn in the rooms of the repository at `root`, in a fixed order."""
    operators = {name: get_operator(name)() for name in sorted(operator_names()) if _is_drawn_from(name)}
    found = []
    for room in ROOMS if (root / "twin" / "kernel").is_dir() else FORMER:
        for path in sorted((root / "twin" / room).rglob("*.py")):
            source = path.read_text()
            compiled, idle = _lines(source)
            statements = _statements(source)
            nodes = list(ast_nodes(get_ast(source)))
            for name, operator in operators.items():
                places = [start for node in nodes for start, _ in operator.mutation_positions(node)]
                found += [
                    Mutant(
                        path.relative_to(root),
                        name,
                        number,
                        line,
                        line in compiled,
                        statements.get(line, range(line, line + 1)),
                    )
                    for number, (line, _) in enumerate(places)
                    if line not in idle
                ]
    return found


def drawn(mutants: list[Mutant], count: int, seed: int) -> list[Mutant]:
    """`count` of `mutants`, a quarter of them in compiled functions; the same for the same seed.

    They are mixed, so that the first of them are a draw, too.
    """
    draw = random.Random(seed)
    compiled = [mutant for mutant in mutants if mutant.is_compiled]
    other = [mutant for mutant in mutants if not mutant.is_compiled]
    quarter = count // 4
    found = draw.sample(compiled, min(quarter, len(compiled))) + draw.sample(other, min(count - quarter, len(other)))
    draw.shuffle(found)
    return found


def _lines(source: str) -> tuple[set[int], set[int]]:
    """Lines of compiled functions; lines of types and decorators, which say what the code does and do nothing."""
    compiled, idle = set(), set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            if any(name in ast.unparse(mark) for mark in node.decorator_list for name in COMPILERS):
                compiled |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
            types = [*node.decorator_list, *(a.annotation for a in node.args.args if a.annotation), node.returns]
            idle |= {line for part in types if part for line in range(part.lineno, (part.end_lineno or 0) + 1)}
        elif isinstance(node, ast.AnnAssign) and node.value is None:
            idle |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return compiled, idle


def _statements(source: str) -> dict[int, range]:
    """By line, the lines of the innermost statement that it belongs to, without the statements inside."""
    found: dict[int, range] = {}
    # outer ones come first
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.stmt):
            whole = range(node.lineno, (node.end_lineno or node.lineno) + 1)
            inside = [part.lineno for part in getattr(node, "body", ())]
            head = range(node.lineno, max(node.lineno + 1, min(inside, default=whole.stop)))
            # a `case` or `except` further down belongs to the whole
            found |= {line: head if line in head else whole for line in whole}
    return found
