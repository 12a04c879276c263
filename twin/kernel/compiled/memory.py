"""Memory as addresses and bytes, for compiled code that writes what others have laid out."""

from twin.kernel.compiled.function import c, intrinsic, ir, types
from twin.kernel.compiled.numba_internals import declared


@intrinsic
def put(typingctx, address, value):
    """Write the number `value`, as wide as its type is, to an address that may be no multiple of that."""

    def codegen(context, builder, signature, arguments):
        to, number = arguments
        written = builder.store(number, builder.inttoptr(to, number.type.as_pointer()))
        written.align = 1
        return context.get_dummy_value()

    return types.void(types.int64, value), codegen


@intrinsic
def copy(typingctx, to, source, count):
    """Copy `count` bytes from address `source` to address `to`, which do not overlap.

    As a loop it would be unrolled for far more than what is copied.
    """

    def codegen(context, builder, signature, arguments):
        to_, source_, count_ = arguments
        kind = ir.FunctionType(c.pointer, [c.pointer, c.pointer, c.i64])
        memcpy = declared(builder.module, kind, "memcpy")
        builder.call(memcpy, [builder.inttoptr(to_, c.pointer), builder.inttoptr(source_, c.pointer), count_])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), codegen
