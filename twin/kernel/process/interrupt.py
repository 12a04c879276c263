"""Ctrl-C where Python would print it and go on: in a finaliser, or in what a library calls back."""

import _thread
import signal
import sys
import threading

INTERRUPTED = 130
"""Exit code of a command that Ctrl-C has ended."""
SOON = 0.01
"""s. By then the finaliser is over: interrupted within it once more, the program would lose that one, too."""


def keep_interrupts() -> None:
    """From now on an interrupt that nobody can catch where it arrives comes again a moment later.

    Compiling is full of such places: each piece of machine code is kept and let go by finalisers and callbacks.
    """
    before = sys.unraisablehook

    def hear(lost: "sys.UnraisableHookArgs") -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            again = threading.Timer(SOON, interrupt_main)
            again.daemon = True
            again.start()
        else:
            before(lost)

    sys.unraisablehook = hear


def interrupt_main() -> None:
    """Raise KeyboardInterrupt in the main thread; to be called by another one."""
    if sys.platform == "win32":
        _thread.interrupt_main()
    else:
        # a real signal, because it also ends a system call that waits
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
