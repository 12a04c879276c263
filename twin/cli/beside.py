"""Work beside that of the main thread, which ends with it."""

import ctypes
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

Answer = TypeVar("Answer")


class Beside(Generic[Answer]):
    """A thread that does `work` during a block; if the block is left by an error or Ctrl-C, it is interrupted, too."""

    def __init__(self, work: Callable[[], Answer]):
        self._work, self._found = work, Future[Answer]()
        self._thread = threading.Thread(target=self._do)

    def __enter__(self) -> "Beside[Answer]":
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *failure: object) -> None:
        if kind and self._thread.ident:
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(self._thread.ident), ctypes.py_object(KeyboardInterrupt)
            )
        self._thread.join()

    def answer(self) -> Answer:
        """What `work` has returned, which is waited for; raises what it raised."""
        return self._found.result()

    def _do(self) -> None:
        try:
            self._found.set_result(self._work())
        except BaseException as failure:
            self._found.set_exception(failure)
