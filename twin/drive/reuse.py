"""Instances that are kept for the next run and reset, in a process that has been told to; else each is made anew.

Only for drives of which it is known that a run after a reset is that of a new instance, bit for bit.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from twin.drive.description import FmuDescription
from twin.drive.instance import Instance
from twin.drive.opened import opened
from twin.drive.setting import Setting
from twin.drive.setup import Setup
from twin.errors import TwinError

_Kind = tuple[str, Path, str, frozenset[str], bool]
"""Name, folder of the unpacked FMU, kind, names of what is set: a reset might leave alone what the next run does not
set; whether its inputs are lines over a step, which is said when it is made."""


class _Shelf:
    """What is kept, if anything is."""

    def __init__(self) -> None:
        self.open = self.left = False
        self.never_freed: list[Instance] = []
        self.instances: dict[_Kind, list[Instance]] = defaultdict(list)


_shelf = _Shelf()


def keep_instances(keep: bool) -> None:
    """From now on keep instances, or no longer."""
    _shelf.open = keep
    free_kept()


@contextmanager
def instances_left() -> Iterator[None]:
    """Within the block none is freed, unless its FMU can live only once in a process: some crash then."""
    _shelf.left = True
    try:
        yield
    finally:
        _shelf.left = False


def free_kept() -> None:
    """Free all that are kept: after a failure nobody knows what state they are in."""
    kept = [instance for instances in _shelf.instances.values() for instance in instances]
    _shelf.instances.clear()
    for instance in kept:
        instance.close()


def instance(
    name: str,
    description: FmuDescription,
    folder: Path,
    settings: Sequence[Setting],
    inputs: Sequence[Setting],
    setup: Setup = Setup(),  # noqa: B008, it is frozen
) -> Instance:
    """One in step mode: a kept one that has been reset, or a new one; arguments as those of `Instance`.

    Raises:
        InputRefused: it cannot be loaded, instantiated or initialised.
        ComponentFailed: it refuses to be reset.
    """
    kept = _shelf.instances[_kind(name, folder, description, settings, setup)]
    if not kept:
        return opened(name, description, folder, settings, inputs, setup)
    found = kept.pop()
    try:
        found.begin_again(settings, inputs, setup)
    except TwinError:
        found.close()
        raise
    return found


def let_go(instance: Instance) -> None:
    """Its run is over: keep it, or free it."""
    kept = _shelf.instances[
        _kind(instance.name, instance.folder, instance.description, instance.settings, instance.setup)
    ]
    if _shelf.left and not instance.description.lives_once:
        _shelf.never_freed.append(instance)
    elif not _shelf.open:
        instance.close()
    elif instance not in kept:
        kept.append(instance)


def _kind(name: str, folder: Path, description: FmuDescription, settings: Sequence[Setting], setup: Setup) -> _Kind:
    names = frozenset(variable.name for variable, _ in settings)
    return name, folder, description.kind, names, setup.ramped
