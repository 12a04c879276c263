"""Connection to a Dask cluster whose machines give the same bits as this one, with a timeout for each answer."""

import asyncio
import functools
import hashlib
import logging
import platform
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeVar

from distributed import Client, Security
from distributed.comm import connect

from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.process.warm import BATCH_TIMEOUT
from twin.robot.paths import PACKAGE_FOLDER, package_sources
from twin.studies.sweep.interrupts import raise_interrupt

CONNECT_TIMEOUT = 5.0
"""Timeout (s) for a scheduler to answer, and for its first worker."""
ANSWER_TIMEOUT = 60.0
"""Timeout (s) for an answer of a cluster in use."""
END_TIMEOUT = 20.0
"""Timeout (s) for each step of ending a sweep."""
COMPARED_PACKAGES = ("numba", "llvmlite", "numpy", "fmpy")

T = TypeVar("T")


class ClusterLost(ComponentFailed):
    """The scheduler or all of its workers are gone, or do not answer; rows until then are kept."""


def call_with_timeout(
    limit: float, call: Callable[..., T], *arguments: Any, hear: Callable[[], None] = raise_interrupt, **named: Any
) -> T:
    """What `call` returns, if that is within `limit` s.

    It is called by a thread of its own: Dask's calls know no limit, or not for all that they do, and no Ctrl-C falls
    between two of their instructions. One that does not return is left behind with its thread.

    Args:
        hear: asked every now and then meanwhile; what it raises is raised here, and `call` goes on.

    Raises:
        TimeoutError: it has not returned.
        KeyboardInterrupt: Ctrl-C.
    """
    answer: Future[T] = Future()

    def work() -> None:
        try:
            answer.set_result(call(*arguments, **named))
        except BaseException as problem:
            answer.set_exception(problem)

    threading.Thread(target=work, daemon=True).start()
    deadline = time.monotonic() + limit
    while not wait([answer], BATCH_TIMEOUT).done:
        hear()
        if time.monotonic() > deadline:
            raise TimeoutError(f"no answer within {limit:g} s")
    return answer.result()


def attempt_with_timeout(limit: float, call: Callable[..., object], *arguments: Any, **named: Any) -> None:
    """`call` something at the end of a sweep, whose failure makes no difference any more; after `limit` s leave it."""
    with suppress(Exception):
        call_with_timeout(limit, call, *arguments, hear=lambda: None, **named)


@contextmanager
def connect_client(scheduler: str) -> Iterator[Client]:
    """Yield a client of the cluster at the address `scheduler`.

    Raises:
        InputRefused: no scheduler answers there, it has no workers, or one is not like this machine.
        ClusterLost: it stops answering.
    """
    with ExitStack() as ends:
        ends.enter_context(_silence_dask())
        _refuse_no_scheduler(scheduler)
        try:
            client = call_with_timeout(
                ANSWER_TIMEOUT, Client, scheduler, timeout=CONNECT_TIMEOUT, set_as_default=False, name="twin-sweep"
            )
        except TimeoutError:
            raise ClusterLost(f"{scheduler}: no answer within {ANSWER_TIMEOUT:g} s") from None
        ends.callback(attempt_with_timeout, END_TIMEOUT, client.close, timeout=CONNECT_TIMEOUT)
        try:
            call_with_timeout(ANSWER_TIMEOUT, client.wait_for_workers, 1, timeout=CONNECT_TIMEOUT)
        except TimeoutError:
            raise InputRefused(
                f"--scheduler {scheduler}: has no workers; start some with: dask worker {scheduler} --nthreads 1"
            ) from None
        refuse_other_versions(client)
        yield client


def refuse_other_versions(client: Client) -> None:
    """Ask the scheduler and every worker what they run.

    Raises:
        InputRefused: one has other versions than this process, or no twin that it could ask.
    """
    workers: dict[str, Any] = {}
    try:
        scheduler: Any = call_with_timeout(ANSWER_TIMEOUT, client.run_on_scheduler, versions)
        workers = call_with_timeout(ANSWER_TIMEOUT, client.run, versions, on_error="return")
    # whatever pickle makes of a module that is not there, or not there yet
    except Exception as problem:
        scheduler = problem
    found = {"the scheduler": scheduler} | {f"worker {address}": theirs for address, theirs in workers.items()}
    if mistakes := [mistake for who, theirs in found.items() if (mistake := difference(who, theirs, versions()))]:
        others = f" ({len(mistakes) - 1} more like it)" if len(mistakes) > 1 else ""
        raise InputRefused(refusal(mistakes[0] + others))


@functools.cache
def versions() -> dict[str, str]:
    """Of this process, by what a user would call it: what has to be the same for a run to give the same bits.

    twin's is followed by a hash of its files: in a clone the number stays while the code changes.
    """
    content = hashlib.sha256()
    for name, source in package_sources(str(PACKAGE_FOLDER)).items():
        content.update(f"{name}\0".encode() + source)
    return {
        "twin": f"{_version('twin')} (files {content.hexdigest()[:8]})",
        "Python": f"{sys.version_info.major}.{sys.version_info.minor}",
        **{package: _version(package) for package in COMPARED_PACKAGES},
        "machine": f"{platform.system()} {platform.machine()}",
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def difference(who: str, theirs: dict[str, str] | BaseException, ours: dict[str, str]) -> str:
    """`tcp://10.0.0.5:4001 has numba 0.59.1, this machine has 0.61.0`; "" if they are the same.

    Args:
        who: was asked for `theirs`; what came of it instead, if there is no twin to ask.
    """
    if not isinstance(theirs, dict):
        return f"{who} has no twin like this one ({type(theirs).__name__}: {theirs})"
    problems = [
        f"{what} {theirs.get(what, 'none')}, this machine has {own}"
        for what, own in ours.items()
        if theirs.get(what) != own
    ]
    return f"{who} has {'; and '.join(problems)}" if problems else ""


def refusal(difference: str) -> str:
    """The sentence about a machine of the cluster that is unlike this one."""
    return (
        f"--engine dask: {difference}; runs would not give the same numbers everywhere: "
        "install the same on all machines (docs/cluster.md)"
    )


def _refuse_no_scheduler(address: str) -> None:
    """Ask the server at `address` for its identity. A client of Dask's would wait for ever for one who never answers.

    Raises:
        InputRefused: no scheduler.
    """

    async def role() -> str:
        comm = await connect(address, timeout=CONNECT_TIMEOUT, **Security().get_connection_args("client"))
        try:
            await comm.write({"op": "identity", "reply": True})
            return (await comm.read())["type"]
        finally:
            comm.abort()

    try:
        # not in this thread, where a notebook's event loop may be running; and to look up a name has no limit of ours
        found = call_with_timeout(2.0 * CONNECT_TIMEOUT, lambda: asyncio.run(asyncio.wait_for(role(), CONNECT_TIMEOUT)))
        if found == "Scheduler":
            return
        reason = f"a {found} does"
    # whatever a foreign server says or an address can be mistaken for
    except (OSError, ValueError, KeyError, TypeError) as problem:
        reason = str(problem).splitlines()[0] if str(problem) else f"not within {CONNECT_TIMEOUT:g} s"
    raise InputRefused(
        f"--scheduler {address}: no Dask scheduler answers there ({reason}); expected the address that dask scheduler "
        "prints, such as tcp://127.0.0.1:8786"
    )


@contextmanager
def _silence_dask() -> Iterator[None]:
    """What Dask has to say of lost connections is said here in a sentence, not by it in a hundred lines."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="distributed")
        try:
            yield
        finally:
            logging.disable(before)
