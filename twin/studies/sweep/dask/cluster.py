"""Getting hold of a Dask cluster: a running one by its address, or one of this machine that lives as long as we do; of
workers that are like this machine and have the files; and of its answers, for which nobody waits without end."""

import asyncio
import logging
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, wait
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from twin.errors import ComponentFailed, InputRefused
from twin.runs.guard.process import others_safe
from twin.studies.left_behind import dask_folder
from twin.studies.sweep.dask import file_store
from twin.studies.sweep.dask.runner import Reply, SweepJob, difference, lack, versions
from twin.studies.sweep.pool import HEAR, raise_if_pressed

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

PATIENCE = 5.0
"""Seconds for a scheduler to answer, and for its first worker to be there."""
ANSWER = 60.0
"""Seconds for an answer of a cluster that is at work."""
TRANSFER = 600.0
"""The same if files travel with it."""
START = 120.0
"""Seconds for a cluster of this machine to be there, its workers with it."""
END = 20.0
"""Seconds for it to be gone, and for anything else that is waited for when a sweep is over."""
SILENT = logging.CRITICAL + 1
_LOGGERS = ("distributed", "tornado", "asyncio")


P = ParamSpec("P")
T = TypeVar("T")


class ClusterLost(ComponentFailed):
    """The scheduler or all of its workers are gone, or do not answer; rows until then are kept."""


def within(limit: float, call: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> T:
    """What `call` returns, if that is within `limit` s.

    It is called by a thread of its own: Dask's calls know no limit, or not for all that they do, and no Ctrl-C falls
    between two of their instructions. One that does not return is left behind with its thread.

    Raises:
        TimeoutError: it has not returned.
        KeyboardInterrupt: Ctrl-C, meanwhile; `call` goes on.
    """
    return _result(_begun(call, *arguments, **named), limit, raise_if_pressed)


def ended_within(limit: float, call: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> None:
    """`call` something at the end of a sweep, whose failure makes no difference any more; after `limit` s leave it."""
    with suppress(Exception):
        _result(_begun(call, *arguments, **named), limit)


def _begun(call: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> "Future[T]":
    answer: Future[T] = Future()

    def work() -> None:
        try:
            answer.set_result(call(*arguments, **named))
        except BaseException as problem:
            answer.set_exception(problem)

    threading.Thread(target=work, daemon=True).start()
    return answer


def _result(answer: "Future[T]", limit: float, hear: Callable[[], None] = lambda: None) -> T:
    deadline = time.monotonic() + limit
    while not wait([answer], HEAR).done:
        hear()
        if time.monotonic() > deadline:
            raise TimeoutError(f"no answer within {limit:g} s")
    return answer.result()


@contextmanager
def connected(scheduler: str | None, processes: int) -> Iterator["Client"]:
    """A client of the cluster of `scheduler`, or of a new one with `processes` workers on this machine.

    Raises:
        InputRefused: dask.distributed is not installed, nobody answers at that address, or there are no workers.
        ClusterLost: the new one does not start.
    """
    try:
        import distributed
    except ImportError:
        raise InputRefused(
            "--engine dask: needs dask.distributed; install it with pip install 'dask>=2024.8' 'distributed>=2024.8'"
        ) from None
    with ExitStack() as ends:
        ends.enter_context(_quiet())
        if scheduler:
            _refuse_no_scheduler(scheduler)
        address = scheduler or ends.enter_context(_local_cluster(processes))
        try:
            client = within(
                ANSWER, distributed.Client, address, timeout=PATIENCE, set_as_default=False, name="twin-sweep"
            )
        except TimeoutError:
            raise ClusterLost(f"{scheduler or 'the cluster of this machine'}: no answer within {ANSWER:g} s") from None
        ends.callback(ended_within, END, client.close, timeout=PATIENCE)
        try:
            within(ANSWER, client.wait_for_workers, 1, timeout=PATIENCE)
        except TimeoutError:
            raise InputRefused(
                f"--scheduler {scheduler}: has no workers; start some with: dask worker {scheduler} --nthreads 1"
            ) from None
        yield client


def checked_workers(client: "Client", sweep: SweepJob) -> dict[str, Reply]:
    """Every worker by its address.

    Raises:
        InputRefused: the scheduler or a worker has other versions than this process, or no twin that it could ask.
    """
    try:
        scheduler = within(ANSWER, client.run_on_scheduler, versions)
        found = within(ANSWER, client.run, lack, sweep, on_error="return")
    # whatever pickle makes of a module that is not there, or not there yet
    except Exception as problem:
        raise InputRefused(_without_twin("the scheduler", problem)) from None
    mistakes = [difference("the scheduler", scheduler, sweep.versions)]
    for address, reply in found.items():
        if not isinstance(reply, Reply):
            mistakes.append(_without_twin(f"worker {address}", reply))
        elif reply.versions:
            mistakes.append(difference(f"worker {address}", reply.versions, sweep.versions))
    if mistakes := [mistake for mistake in mistakes if mistake]:
        others = f" ({len(mistakes) - 1} more like it)" if len(mistakes) > 1 else ""
        raise InputRefused(refusal(mistakes[0] + others))
    return found


def send_missing(client: "Client", contents: Mapping[str, bytes], found: Mapping[str, Reply]) -> None:
    """Send the file stores of `found` what they have not, once to each, whatever number of workers it serves.

    Raises:
        InputRefused: a store cannot take it.
        ClusterLost: it does not.
    """
    first = {reply.store: (address, reply.missing) for address, reply in found.items() if reply.missing}
    by_need: dict[tuple[str, ...], list[str]] = {}
    for address, missing in first.values():
        by_need.setdefault(missing, []).append(address)
    for missing, addresses in by_need.items():
        files = {digest: contents[digest] for digest in missing}
        try:
            within(TRANSFER, client.run, file_store.keep, files, workers=addresses)
        except TimeoutError:
            raise ClusterLost(f"{', '.join(addresses)}: took no files within {TRANSFER:g} s") from None


def refusal(difference: str) -> str:
    """The sentence about a machine of the cluster that is unlike this one."""
    return (
        f"--engine dask: {difference}; runs would not give the same numbers everywhere: "
        "install the same on all machines (docs/cluster.md)"
    )


def _without_twin(who: str, problem: BaseException) -> str:
    return f"{who} has no twin like this one ({type(problem).__name__}: {problem})"


def _refuse_no_scheduler(address: str) -> None:
    """Ask whoever is at `address` who it is. A client of Dask's would wait for ever for one who never answers.

    Raises:
        InputRefused: no scheduler.
    """
    from distributed import Security
    from distributed.comm import connect

    async def role() -> str:
        comm = await connect(address, timeout=PATIENCE, **Security().get_connection_args("client"))
        try:
            await comm.write({"op": "identity", "reply": True})
            return (await comm.read())["type"]
        finally:
            comm.abort()

    try:
        # not in this thread, where a notebook's event loop may be running; and to look up a name has no limit of ours
        found = within(2.0 * PATIENCE, lambda: asyncio.run(asyncio.wait_for(role(), PATIENCE)))
        if found == "Scheduler":
            return
        reason = f"a {found} does"
    # whatever a foreign server says or an address can be mistaken for
    except (OSError, ValueError, KeyError, TypeError) as problem:
        reason = str(problem).splitlines()[0] if str(problem) else f"not within {PATIENCE:g} s"
    raise InputRefused(
        f"--scheduler {address}: no Dask scheduler answers there ({reason}); expected the address that dask scheduler "
        "prints, such as tcp://127.0.0.1:8786"
    )


@contextmanager
def _local_cluster(processes: int) -> Iterator[object]:
    """Workers of one thread each, on the loopback interface; nothing of it is left in the end."""
    with others_safe(), dask_folder() as folder:
        # Python's resource tracker, if it is started on the way, unblocks what was blocked, so it is started before
        resource_tracker.ensure_running()
        starting = _begun(_started, processes, str(folder))
        try:
            # Ctrl-C is answered when it is there, because half a cluster cannot be ended
            cluster = _result(starting, START)
        except BaseException as problem:
            starting.add_done_callback(_close)
            if isinstance(problem, TimeoutError):
                raise ClusterLost(f"the Dask cluster of this machine did not start within {START:g} s") from None
            raise
        try:
            yield cluster
        finally:
            ended_within(END, cluster.close)


def _close(started: "Future[LocalCluster]") -> None:
    if not started.exception():
        started.result().close()


def _started(processes: int, folder: str) -> "LocalCluster":
    """In a thread of its own."""
    import dask.config
    from distributed import LocalCluster

    # Ctrl-C at a terminal reaches every process there; how a sweep stops is for us to say, so the workers do not hear
    # it: they inherit what is blocked in the thread that starts them
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    # every web page may ask what Dask serves: it serves nothing, at ports that nobody knows beforehand
    routes: dict[str, list[str]] = {f"distributed.{role}.http.routes": [] for role in ("scheduler", "worker")}
    with dask.config.set({"temporary-directory": folder, **routes}):
        return LocalCluster(
            n_workers=processes,
            threads_per_worker=1,
            host="127.0.0.1",
            # runs live in processes of their own, with a limit of their own
            memory_limit=0,
            silence_logs=SILENT,
            # what is tried again is for us to say
            scheduler_kwargs={"allowed_failures": 0, "dashboard": False, "dashboard_address": "127.0.0.1:0"},
            worker_dashboard_address=None,
        )


@contextmanager
def _quiet() -> Iterator[None]:
    """What Dask has to say of lost connections is said here in a sentence, not by it in a hundred lines."""
    loggers = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in _LOGGERS]
    levels = {name: logging.getLogger(name).level for name in loggers}
    for name in levels:
        logging.getLogger(name).setLevel(SILENT)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="distributed")
        try:
            yield
        finally:
            for name, level in levels.items():
                logging.getLogger(name).setLevel(level)
