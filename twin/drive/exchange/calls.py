"""C functions, called by address from compiled code: those of an FMU's model exchange, and the solver's."""

from typing import Any

from twin.compiled.function import c, intrinsic, ir, types

_KINDS = {
    "pointer": ("int64", "pointer"),
    "double": ("float64", "f64"),
    "size": ("int64", "i64"),
    "int": ("int64", "i32"),
    "byte": ("int64", "i8"),
}
"""What numba and LLVM call it."""


def foreign(*kinds: str, returns: str = "int") -> Any:
    """A compiled function (address, (arguments)) that calls the C function at that address.

    Args:
        kinds: of its arguments: "pointer", "double", "size" (64 bit), "int" (32 bit), "byte".
        returns: "int" or "pointer".
    """

    @intrinsic
    def call(typingctx, function, arguments):
        result = types.int32 if returns == "int" else types.int64
        native = [getattr(c, _KINDS[kind][1]) for kind in kinds]

        def codegen(context, builder, _, given):
            target = ir.FunctionType(getattr(c, _KINDS[returns][1]), native).as_pointer()
            passed = []
            for i, kind in enumerate(kinds):
                value = builder.extract_value(given[1], i)
                if kind == "pointer":
                    value = builder.inttoptr(value, c.pointer)
                elif kind in ("int", "byte"):
                    value = builder.trunc(value, native[i])
                passed.append(value)
            returned = builder.call(builder.inttoptr(given[0], target), passed)
            return builder.ptrtoint(returned, c.i64) if returns == "pointer" else returned

        return result(types.int64, types.Tuple([getattr(types, _KINDS[kind][0]) for kind in kinds])), codegen

    return call


plain = foreign("pointer")
"""`fmiNEnterEventMode(c)`, `fmiNEnterContinuousTimeMode(c)`."""
at_time = foreign("pointer", "double")
"""`fmiNSetTime(c, t)`, `CVodeSetStopTime(memory, t)`."""
on_doubles = foreign("pointer", "pointer", "size")
"""`fmiNSetContinuousStates(c, x, n)` and all other functions of states, derivatives and event indicators."""
on_pointer = foreign("pointer", "pointer")
"""`fmi2NewDiscreteStates(c, info)`, `fmi3GetNumberOfContinuousStates(c, n)`."""
completed_2 = foreign("pointer", "int", "pointer", "pointer")
completed_3 = foreign("pointer", "byte", "pointer", "pointer")
"""`fmiNCompletedIntegratorStep(c, noSetFMUStatePriorToCurrentPoint, enterEventMode, terminateSimulation)`."""
update_3 = foreign("pointer", "pointer", "pointer", "pointer", "pointer", "pointer", "pointer")
"""`fmi3UpdateDiscreteStates(c, five flags, next time)`."""
start_at = foreign("pointer", "double", "pointer")
"""`CVodeReInit(memory, t, x)`, `CVodeSVtolerances(memory, relative, absolute)`."""
one_step = foreign("pointer", "double", "pointer", "pointer", "int")
"""`CVode(memory, t_out, x, t_reached, task)`."""
values_of = foreign("pointer", returns="pointer")
"""`N_VGetArrayPointer(vector)`."""
