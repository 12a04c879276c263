"""Machine code as a function of the interpreter, which calls it in a fifth of the time that ctypes needs."""

import ctypes
from collections.abc import Callable, Sequence

PYTHON = ".python"
"""What stands behind a symbol in the name of the function that the interpreter calls in its place."""
_METH_FASTCALL = 0x80
"""Of the C API: `PyObject *f(PyObject *self, PyObject *const *arguments, Py_ssize_t count)`."""

_TAKEN = {
    "i64": "  %a{i} = call i64 @PyLong_AsLongLong(ptr %object{i})",
    "ptr": "  %n{i} = call i64 @PyLong_AsLongLong(ptr %object{i})\n  %a{i} = inttoptr i64 %n{i} to ptr",
    "double": "  %a{i} = call double @PyFloat_AsDouble(ptr %object{i})",
}
_GIVEN = {
    "i64": "  %object = call ptr @PyLong_FromLongLong(i64 %result)\n  ret ptr %object",
    "double": "  %object = call ptr @PyFloat_FromDouble(double %result)\n  ret ptr %object",
    "void": "  call void @Py_IncRef(ptr @_Py_NoneStruct)\n  ret ptr @_Py_NoneStruct",
}
"""By LLVM's names: how an argument is taken from an object, how an object is made of the result."""


class _Definition(ctypes.Structure):
    """PyMethodDef."""

    _fields_ = (
        ("name", ctypes.c_char_p), ("function", ctypes.c_void_p), ("flags", ctypes.c_int), ("doc", ctypes.c_char_p),
    )  # fmt: skip


_definitions: list[_Definition] = []
"""The interpreter keeps their addresses."""


def built_in(address: int, name: str) -> Callable:
    """The function at `address`, which `in_front_of` has written."""
    _definitions.append(_Definition(name.encode(), address, _METH_FASTCALL, None))
    make = ctypes.pythonapi.PyCFunction_NewEx
    make.restype, make.argtypes = ctypes.py_object, [ctypes.c_void_p] * 3
    made: Callable = make(ctypes.addressof(_definitions[-1]), None, None)
    return made


def in_front_of(symbol: str, returns: str, takes: Sequence[str]) -> str:
    """LLVM's assembly of what the interpreter calls for the function `symbol`; its lock is free while that runs.

    Nobody looks whether the arguments are numbers, and as many as they should be.

    Args:
        symbol: of the function.
        returns, takes: LLVM's types.
    """
    arguments = "\n".join(
        f"  %at{i} = getelementptr ptr, ptr %arguments, i64 {i}\n  %object{i} = load ptr, ptr %at{i}\n"
        + _TAKEN[kind].format(i=i)
        for i, kind in enumerate(takes)
    )
    passed = ", ".join(f"{kind} %a{i}" for i, kind in enumerate(takes))
    result = "" if returns == "void" else "%result = "
    return f"""
declare i64 @PyLong_AsLongLong(ptr)
declare ptr @PyLong_FromLongLong(i64)
declare double @PyFloat_AsDouble(ptr)
declare ptr @PyFloat_FromDouble(double)
declare ptr @PyEval_SaveThread()
declare void @PyEval_RestoreThread(ptr)
declare void @Py_IncRef(ptr)
@_Py_NoneStruct = external global i8
define ptr @"{symbol}{PYTHON}"(ptr %self, ptr %arguments, i64 %count) {{
{arguments}
  %thread = call ptr @PyEval_SaveThread()
  {result}call {returns} @"{symbol}"({passed})
  call void @PyEval_RestoreThread(ptr %thread)
{_GIVEN[returns]}
}}
"""
