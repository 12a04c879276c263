"""C's `exit` called by third-party code in a process without a supervisor."""

import contextlib
import ctypes
import os
import sys
from collections.abc import Callable, Iterator

from twin.kernel.errors import ComponentFailed

EXIT_MESSAGE = "a component ended the process with exit(); an isolated run reports its name and the step"


@contextlib.contextmanager
def report_exit(message: Callable[[], str]) -> Iterator[None]:
    """Print `message()` and end with the code of a failed component if C's `exit` is called within the block.

    Only where the C library can remove the handler again: Python has ended before the process does.
    """
    process, reporting = os.getpid(), True

    @ctypes.CFUNCTYPE(None, ctypes.c_void_p)
    def on_exit(_: int | None) -> None:
        # a process that a component has forked may exit
        if reporting and os.getpid() == process:
            with contextlib.suppress(Exception):
                print(message(), file=sys.stderr)
                sys.stdout.flush()
            os._exit(ComponentFailed.exit_code)

    library = ctypes.CDLL(None) if os.name == "posix" else None
    if library is None or not (hasattr(library, "__cxa_atexit") and hasattr(library, "__cxa_finalize")):
        yield
        return
    # handlers of a shared library are removed when it is unloaded; its identity is any address
    owner = ctypes.c_byte()
    library.__cxa_atexit(on_exit, None, ctypes.byref(owner))
    try:
        yield
    finally:
        reporting = False
        library.__cxa_finalize(ctypes.byref(owner))
