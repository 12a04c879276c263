"""Connection to a Dask cluster whose machines compute the same bits as this one, with a timeout for each answer."""

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
    """Error for the loss of scheduler, all workers or an answer during a sweep; rows written before are kept."""


def call_with_timeout(
    limit: float, call: Callable[..., T], *arguments: Any, hear: Callable[[], None] = raise_interrupt, **named: Any
) -> T:
    """Run a call in a separate thread and return its result within `limit` s, else raise TimeoutError.

    Dask's calls have no complete timeout, and in a separate thread Ctrl-C cannot interrupt them halfway. A call that
    does not return is abandoned with its thread. `hear` is polled while waiting; its exceptions propagate.
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
    """Run a cleanup call whose failure no longer matters, and abandon it after `limit` s."""
    with suppress(Exception):
        call_with_timeout(limit, call, *arguments, hear=lambda: None, **named)


@contextmanager
def connect_client(scheduler: str) -> Iterator[Client]:
    """Yield a client of the scheduler's cluster; refuse other machines, raise `ClusterLost` if it stops answering."""
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
    """Refuse a Dask cluster unless scheduler and workers run the same versions as this process."""
    workers: dict[str, Any] = {}
    try:
        scheduler: Any = call_with_timeout(ANSWER_TIMEOUT, client.run_on_scheduler, versions)
        workers = call_with_timeout(ANSWER_TIMEOUT, client.run, versions, on_error="return")
    # Unpickling a missing module can raise any exception.
    except Exception as problem:
        scheduler = problem
    found = {"the scheduler": scheduler} | {f"worker {address}": theirs for address, theirs in workers.items()}
    if mistakes := [mistake for who, theirs in found.items() if (mistake := difference(who, theirs, versions()))]:
        others = f" ({len(mistakes) - 1} more like it)" if len(mistakes) > 1 else ""
        raise InputRefused(refusal(mistakes[0] + others))


@functools.cache
def versions() -> dict[str, str]:
    """Return the versions that decide a run's bits; twin's with a hash of its files, as code in a clone changes."""
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
    """Describe a difference, `tcp://10.0.0.5:4001 has numba 0.59.1, this machine has 0.61.0`, or "" if equal."""
    if not isinstance(theirs, dict):
        return f"{who} has no twin like this one ({type(theirs).__name__}: {theirs})"
    problems = [
        f"{what} {theirs.get(what, 'none')}, this machine has {own}"
        for what, own in ours.items()
        if theirs.get(what) != own
    ]
    return f"{who} has {'; and '.join(problems)}" if problems else ""


def refusal(difference: str) -> str:
    return (
        f"--engine dask: {difference}; runs would not give the same numbers everywhere: "
        "install the same on all machines (docs/sweep.md)"
    )


def _refuse_no_scheduler(address: str) -> None:
    """Refuse an address where no Dask scheduler answers; Dask's client would wait forever for a silent server."""

    async def role() -> str:
        comm = await connect(address, timeout=CONNECT_TIMEOUT, **Security().get_connection_args("client"))
        try:
            await comm.write({"op": "identity", "reply": True})
            return (await comm.read())["type"]
        finally:
            comm.abort()

    try:
        # In a separate thread, as a notebook's event loop may run in this one, and because name resolution has no
        # timeout.
        found = call_with_timeout(2.0 * CONNECT_TIMEOUT, lambda: asyncio.run(asyncio.wait_for(role(), CONNECT_TIMEOUT)))
        if found == "Scheduler":
            return
        reason = f"a {found} does"
    # Errors of a foreign server or an invalid address.
    except (OSError, ValueError, KeyError, TypeError) as problem:
        reason = str(problem).splitlines()[0] if str(problem) else f"not within {CONNECT_TIMEOUT:g} s"
    raise InputRefused(
        f"--scheduler {address}: no Dask scheduler answers there ({reason}); expected the address that dask scheduler "
        "prints, such as tcp://127.0.0.1:8786"
    )


@contextmanager
def _silence_dask() -> Iterator[None]:
    """Suppress Dask's log output about lost connections, which twin reports in one sentence."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="distributed")
        try:
            yield
        finally:
            logging.disable(before)
