"""`make wheel`: a wheel for Linux on x86-64 with all that twin compiles, as machine code in each form of the processor.

Without it `pip wheel .` makes one for any machine, on which the first run compiles.
"""

import importlib
import itertools
import os
import pkgutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path

import twin
from hatch_build import OBJECTS
from twin.kernel.compiled.machine import X86_64, object_name
from twin.kernel.compiled.native import Entry, Native
from twin.kernel.compiled.store import seal
from twin.robot import shaft
from twin.robot.controller import controller, task_controller
from twin.robot.monitor import component as monitor
from twin.robot.plant import component, equations

ROOT = Path(__file__).parent
CLOSED = (
    (controller.make_step, 2),
    (task_controller.make_step, 2),
    (component.make_step, 2),
    (equations.outputs_at_start, 2),
    (shaft.make_shaft_step, 1),
    (monitor.make_step, 1),
)
"""Functions that make a step, and of how many booleans."""


@cache
def roots() -> list[Native]:
    """Every function of twin that C or Python calls, but for those that users write."""
    found = {native.name: native for native in (*_at_import(), *_closures())}
    return [found[name] for name in sorted(found)]


def _at_import() -> Iterator[Native]:
    for module in pkgutil.walk_packages(twin.__path__, "twin."):
        if not module.name.endswith("__main__"):
            for value in vars(importlib.import_module(module.name)).values():
                if isinstance(value, Native | Entry):
                    yield value.native if isinstance(value, Entry) else value


def _closures() -> Iterator[Native]:
    for make, count in CLOSED:
        for case in itertools.product((False, True), repeat=count):
            yield make(*case)


def put_objects(folder: Path, number: int) -> int:
    """Put the object files of the root `number` into a folder; how many bytes they have."""
    native = roots()[number]
    size = 0
    for form in X86_64:
        file = object_name(native.name, form)
        size += (folder / file).write_bytes(seal(file, native.emitted(form)))
    return size


def main(target: str) -> int:
    """Build the wheel into the folder `target`; the exit code is hatchling's."""
    count = len(roots())
    with tempfile.TemporaryDirectory() as folder:
        with ProcessPoolExecutor() as pool:
            size = sum(pool.map(put_objects, itertools.repeat(Path(folder)), range(count)))
        print(f"{count} functions in {len(X86_64)} forms, {size / 1e6:.1f} MB", flush=True)
        command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", target]
        return subprocess.run(command, cwd=ROOT, env={**os.environ, OBJECTS: folder}).returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
