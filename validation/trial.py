"""Run the yardsticks of a file."""

import pkgutil
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from multiprocessing import get_context

from validation import yardsticks
from validation.yardstick import Finding, Yardstick, found


def names() -> list[str]:
    """Of all files of yardsticks."""
    return sorted(module.name for module in pkgutil.iter_modules(yardsticks.__path__))


def of_file(name: str) -> tuple[Yardstick, ...]:
    """The yardsticks of a file."""
    return tuple(import_module(f"{yardsticks.__name__}.{name}").YARDSTICKS)


def tried(name: str) -> list[Finding]:
    """Run the yardsticks of a file in this process."""
    return [found(name, yardstick) for yardstick in of_file(name)]


def apart(name: str) -> list[Finding]:
    """The same in a process of its own: what others made may crash."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        try:
            return pool.submit(tried, name).result()
        except BrokenProcessPool:
            return [Finding(name, yardstick, remark="its process crashed") for yardstick in of_file(name)]
