"""Before the first run: whether the workers are like this machine, and whatever of the files they have not yet."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from twin.errors import InputRefused
from twin.studies.sweep.dask import depot
from twin.studies.sweep.dask.versions import difference, versions
from twin.studies.sweep.dask.workplace import Survey, survey

if TYPE_CHECKING:
    from distributed import Client


def surveyed(client: "Client", digests: Iterable[str]) -> dict[str, Survey]:
    """Every worker by its address.

    Raises:
        InputRefused: the scheduler or a worker has other versions than this process, or no twin that it could ask.
    """
    ours = versions()
    try:
        scheduler = client.run_on_scheduler(versions)
        found = client.run(survey, tuple(digests), on_error="return")
    # whatever pickle makes of a module that is not there, or not there yet
    except Exception as problem:
        raise InputRefused(without_twin("the scheduler", problem)) from None
    mistakes = [difference("the scheduler", scheduler, ours)]
    for address, answer in found.items():
        if isinstance(answer, Survey):
            mistakes.append(difference(f"worker {address}", answer.versions, ours))
        else:
            mistakes.append(without_twin(f"worker {address}", answer))
    if mistakes := [mistake for mistake in mistakes if mistake]:
        others = f" ({len(mistakes) - 1} more like it)" if len(mistakes) > 1 else ""
        raise InputRefused(refusal(mistakes[0] + others))
    return found


def deliver(client: "Client", contents: Mapping[str, bytes], found: Mapping[str, Survey]) -> None:
    """Send what the depots of `found` have not, once to each, whatever number of workers it serves.

    Raises:
        InputRefused: a depot cannot take it.
    """
    first = {answer.depot: (address, answer.missing) for address, answer in found.items() if answer.missing}
    by_need: dict[tuple[str, ...], list[str]] = {}
    for address, missing in first.values():
        by_need.setdefault(missing, []).append(address)
    for missing, addresses in by_need.items():
        client.run(depot.keep, {digest: contents[digest] for digest in missing}, workers=addresses)


def refusal(difference: str) -> str:
    """The sentence about a machine of the cluster that is unlike this one."""
    return (
        f"--engine dask: {difference}; runs would not give the same numbers everywhere: "
        "install the same on all machines (docs/cluster.md)"
    )


def without_twin(who: str, problem: BaseException) -> str:
    """What `who` lacks that answers a question about versions with `problem`."""
    return f"{who} has no twin like this one ({type(problem).__name__}: {problem})"
