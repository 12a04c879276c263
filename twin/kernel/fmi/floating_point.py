"""The floating-point mode of a thread: rounding, flush to zero, masked exceptions; known on x86-64 Linux only."""

import ctypes
import platform
import sys
from typing import NamedTuple

CONTROL_WORD, MXCSR = 0, 7
"""Places of the x87 control word and of MXCSR in glibc's `fenv_t`, in units of 32 bits."""
CONTROL_BITS, MXCSR_BITS = 0xFFFF, 0xFFC0
"""Their bits without the flags that every operation sets."""
_LIBM = ctypes.CDLL("libm.so.6") if sys.platform == "linux" and platform.machine() == "x86_64" else None


class Mode(NamedTuple):
    """Floating-point control bits of the processor's two units (rounding, exceptions); 0 on other platforms."""

    x87: int = 0
    sse: int = 0


def mode() -> Mode:
    """Return the floating-point mode (rounding, exceptions) of the calling thread."""
    if _LIBM is None:
        return Mode()
    environment = (ctypes.c_uint32 * 8)()
    _LIBM.fegetenv(environment)
    return Mode(environment[CONTROL_WORD] & CONTROL_BITS, environment[MXCSR] & MXCSR_BITS)


def set_mode(wanted: Mode) -> None:
    """Set the floating-point mode (rounding, exceptions) of the calling thread; exception flags stay."""
    if _LIBM is None:
        return
    environment = (ctypes.c_uint32 * 8)()
    _LIBM.fegetenv(environment)
    environment[CONTROL_WORD] = environment[CONTROL_WORD] & ~CONTROL_BITS | wanted.x87
    environment[MXCSR] = environment[MXCSR] & ~MXCSR_BITS | wanted.sse
    _LIBM.fesetenv(environment)
