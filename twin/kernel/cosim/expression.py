"""Expressions of time, such as `2*step(1.0) - 0.5*sin(2*pi*t)`: parsed without executing code, evaluated compiled.

The grammar consists of numbers, `t` (s), `pi`, + - * / **, brackets and the functions of `FUNCTION_CODES`. Python's
parser reads it, and any other syntax is refused. The result is a list of operations of a stack machine.
"""

import ast
import math
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from twin.kernel.compiled.function import carray, njit
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import doubles_at, integers_at
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.units import parse_float

MAX_LENGTH = 1000
"""Maximum length of an expression (characters)."""
TIME_TOLERANCE = 1e-9
"""Tolerance of times (s, and relative): t is a rounded multiple of the tick, and events take effect at the nearest."""
(
    OP_NUMBER,
    OP_TIME,
    OP_ADD,
    OP_SUBTRACT,
    OP_MULTIPLY,
    OP_DIVIDE,
    OP_POWER,
    OP_NEGATE,
    OP_SIN,
    OP_COS,
    OP_EXP,
    OP_STEP,
    OP_RAMP,
    OP_RISE,
    OP_PULSE,
    OP_PULSES,
) = range(16)
OPERATOR_CODES = {ast.Add: OP_ADD, ast.Sub: OP_SUBTRACT, ast.Mult: OP_MULTIPLY, ast.Div: OP_DIVIDE, ast.Pow: OP_POWER}
FUNCTION_CODES: dict[str, dict[int, int]] = {
    "sin": {1: OP_SIN},
    "cos": {1: OP_COS},
    "exp": {1: OP_EXP},
    "step": {1: OP_STEP},
    "ramp": {1: OP_RAMP, 2: OP_RISE},
    "pulse": {2: OP_PULSE, 3: OP_PULSES},
}
"""Operation by function name and number of arguments: sin, cos and exp of a number; `step(start)` is 1 from `start` on;
`ramp(start)` is the time since `start`; `ramp(start, duration)` rises from 0 to 1; `pulse(start, width)` is 1 for
`width`, `pulse(start, width, period)` repeats. All are 0 before `start`."""
GRAMMAR_PHRASE = "numbers, t, pi, + - * / ** and " + ", ".join(FUNCTION_CODES)


@dataclass(frozen=True)
class Expression:
    """A mathematical expression of time, compiled to a program of a stack machine that needs `depth` places.

    `operations` are its codes, (n,) int64; `numbers` the operand of each OP_NUMBER, (n,).
    """

    text: str
    operations: np.ndarray
    numbers: np.ndarray
    depth: int

    def value_at(self, t: float) -> float:
        """Return the value of the expression at time `t` (s); NaN if undefined."""
        stack = np.empty(self.depth)
        return float(
            _value(
                self.operations.ctypes.data, self.numbers.ctypes.data, len(self.operations), stack.ctypes.data, float(t)
            )
        )


def parse_expression(text: str, where: str) -> Expression:
    """Parse a mathematical expression of time into a program of a stack machine."""
    if len(text) > MAX_LENGTH:
        raise InputRefused(f"{where}: an expression of {len(text)} characters; expected at most {MAX_LENGTH}")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    # MemoryError and RecursionError: too deeply nested brackets
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise InputRefused(
            f"{where}: '{text}' is neither a file nor an expression; expected {GRAMMAR_PHRASE}"
        ) from None
    reader = _ExpressionReader(where, text.strip())
    try:
        reader.visit(tree.body)
    except RecursionError:
        raise InputRefused(f"{where}: an expression with too many brackets") from None
    operations, numbers = (np.array(column) for column in zip(*reader.program, strict=True))
    return Expression(text, operations.astype(np.int64), numbers.astype(float), reader.deepest)


class _ExpressionReader:
    def __init__(self, where: str, text: str):
        self._where, self._text = where, text
        self.program: list[tuple[int, float]] = []
        self._depth = self.deepest = 0

    def visit(self, node: ast.expr) -> None:
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                self._append(OP_NUMBER, 0, self._number(ast.get_source_segment(self._text, node) or ""))
            case ast.Name(id="t"):
                self._append(OP_TIME, 0)
            case ast.Name(id="pi"):
                self._append(OP_NUMBER, 0, math.pi)
            case ast.BinOp(op=op) if type(op) in OPERATOR_CODES:
                self.visit(node.left)
                self.visit(node.right)
                self._append(OPERATOR_CODES[type(op)], 2)
            case ast.UnaryOp(op=ast.USub()):
                self.visit(node.operand)
                self._append(OP_NEGATE, 1)
            case ast.UnaryOp(op=ast.UAdd()):
                self.visit(node.operand)
            case ast.Call(func=ast.Name(id=name), keywords=[]) if name in FUNCTION_CODES:
                kinds = FUNCTION_CODES[name]
                if len(node.args) not in kinds:
                    expected = " or ".join(map(str, kinds))
                    self._refuse(f"{name} of {len(node.args)} arguments; expected {expected}")
                for one in node.args:
                    self.visit(one)
                self._append(kinds[len(node.args)], len(node.args))
            case ast.Call(func=ast.Name(id=name)) | ast.Name(id=name) if name not in FUNCTION_CODES:
                hint = nearest(name, [*FUNCTION_CODES, "t", "pi"], f"expected {GRAMMAR_PHRASE}")
                self._refuse(f"'{name}' is not known; {hint}")
            case _:
                self._refuse(f"'{ast.unparse(node)}' is not allowed; expected {GRAMMAR_PHRASE}")

    def _number(self, text: str) -> float:
        number = parse_float(text)
        if number is None:
            self._refuse(f"'{text}' is not allowed; expected {GRAMMAR_PHRASE}")
        if not math.isfinite(number):
            self._refuse("a number beyond the range of numbers")
        return number

    def _append(self, operation: int, taken: int, number: float = 0.0) -> None:
        self.program.append((operation, number))
        self._depth += 1 - taken
        self.deepest = max(self.deepest, self._depth)

    def _refuse(self, what: str) -> NoReturn:
        raise InputRefused(f"{self._where}: {what}")


@njit(cache=True, error_model="numpy")
def has_begun(t, start):
    """Whether time `t` is at or after `start`, within `TIME_TOLERANCE`."""
    return t - start >= -TIME_TOLERANCE * max(1.0, abs(start))


@njit(cache=True, error_model="numpy")
def evaluate(operations_at, numbers_at, count, stack_at, t):
    """Evaluate an expression at time `t`; its operations, numbers and stack are at the given addresses."""
    operations, numbers = carray(integers_at(operations_at), count), carray(doubles_at(numbers_at), count)
    stack = carray(doubles_at(stack_at), count)
    top = -1
    for k in range(count):
        what = operations[k]
        if what == OP_NUMBER:
            top += 1
            stack[top] = numbers[k]
        elif what == OP_TIME:
            top += 1
            stack[top] = t
        elif what == OP_NEGATE:
            stack[top] = -stack[top]
        elif what == OP_SIN:
            stack[top] = math.sin(stack[top])
        elif what == OP_COS:
            stack[top] = math.cos(stack[top])
        elif what == OP_EXP:
            stack[top] = math.exp(stack[top])
        elif what == OP_STEP:
            stack[top] = 1.0 if has_begun(t, stack[top]) else 0.0
        elif what == OP_RAMP:
            stack[top] = max(0.0, t - stack[top])
        else:
            if what == OP_PULSES:
                top -= 2
                start, wide, period = stack[top], stack[top + 1], stack[top + 2]
                since = t - start
                # within the tolerance, a period that is about to begin has begun
                since -= period * math.floor((since + TIME_TOLERANCE * max(1.0, abs(t))) / period)
                value = 1.0 if has_begun(t, start) and not has_begun(since, wide) else 0.0
                stack[top] = value if period > 0.0 else math.nan
                continue
            top -= 1
            a, b = stack[top], stack[top + 1]
            if what == OP_ADD:
                stack[top] = a + b
            elif what == OP_SUBTRACT:
                stack[top] = a - b
            elif what == OP_MULTIPLY:
                stack[top] = a * b
            elif what == OP_DIVIDE:
                stack[top] = a / b
            elif what == OP_POWER:
                stack[top] = a**b
            elif what == OP_RISE:
                stack[top] = 1.0 if has_begun(t, a + b) else max(0.0, (t - a) / b)
            else:
                stack[top] = 1.0 if has_begun(t, a) and not has_begun(t, a + b) else 0.0
    return stack[0]


@entry("double", "int", "int", "int", "int", "double")
def _value(operations, numbers, count, stack, t):
    return evaluate(operations, numbers, count, stack, t)
