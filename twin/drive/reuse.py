"""Whether an instance is freed when its run is over."""

from collections.abc import Iterator
from contextlib import contextmanager

from twin.drive.instance import Instance


class _Left:
    """Whether instances are left as they are now, and those that were."""

    def __init__(self) -> None:
        self.now = False
        self.instances: list[Instance] = []


_left = _Left()


@contextmanager
def instances_left() -> Iterator[None]:
    """Within the block none is freed, unless its FMU can live only once in a process: some crash then."""
    _left.now = True
    try:
        yield
    finally:
        _left.now = False


def let_go(instance: Instance) -> None:
    """Its run is over: free it, but not within `instances_left`."""
    if _left.now and not instance.description.lives_once:
        _left.instances.append(instance)
    else:
        instance.close()
