"""A guarded process that is started before it is known what for: it imports while the command line is being read."""

from twin.kernel.process.process import GuardedProcess

_waiting: dict[str, GuardedProcess] = {}


def start_ahead(job: str) -> None:
    """Start a process that will be asked for `job`, if somebody asks."""
    _waiting[job] = GuardedProcess(job)


def taken(job: str) -> GuardedProcess | None:
    """The process that was started ahead for `job`, if one was; none waits any more."""
    found = _waiting.pop(job, None)
    end_waiting()
    return found


def process_for(job: str) -> GuardedProcess:
    """The process that was started ahead for `job`, or a new one; none waits any more."""
    return taken(job) or GuardedProcess(job)


def end_waiting() -> None:
    """End what nobody has asked for."""
    while _waiting:
        _waiting.popitem()[1].close()
