"""A command's work with FMUs, in a process of its own: if one crashes, the command ends with a sentence."""

from collections.abc import Callable
from typing import Any

from twin.cli.options import JobIsolation
from twin.errors import ComponentFailed


def finished(
    job: Callable[..., Any],
    arguments: dict[str, Any],
    isolate: JobIsolation,
    say: Callable[[str], None] = lambda what: None,
) -> Any:
    """What `job(voice, **arguments)` returns.

    Args:
        job: function of a module; arguments and result are what JSON can hold. What it notes as `say` is told to `say`.
        isolate: what gets a process of its own.

    Raises:
        ComponentFailed: an FMU crashed, hung or ended that process. With nothing recorded to lose it is no matter
            whether stepping had begun.
        TwinError: the job raised one: text and exit code are those.
    """

    def hear(note: dict[str, Any]) -> None:
        say(note["say"])

    if isolate == JobIsolation.NONE:
        from twin.runs.guard.voice import DirectVoice

        return job(DirectVoice(hear, lambda done, total: None), **arguments)
    from twin.runs.guard.guard import JobDied, JobDiedLoading, guarded

    try:
        return guarded(f"{job.__module__}:{job.__name__}", arguments, listen=hear)
    except (JobDied, JobDiedLoading) as death:
        raise ComponentFailed(str(death)) from None
