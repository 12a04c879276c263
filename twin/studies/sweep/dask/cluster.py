"""Getting hold of a Dask cluster: a running one by its address, or one of this machine that lives as long as we do; and
of workers that are like this machine and have the files."""

import asyncio
import logging
import signal
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING

from twin.errors import InputRefused
from twin.runs.guard.interpreter import others_safe
from twin.studies.sweep.dask import file_store
from twin.studies.sweep.dask.runner import Reply, SweepJob, lack
from twin.studies.sweep.dask.versions import difference, versions

if TYPE_CHECKING:
    from distributed import Client

PATIENCE = 5.0
"""Seconds for a scheduler to answer, and for its first worker to be there."""
SILENT = logging.CRITICAL + 1
_LOGGERS = ("distributed", "tornado", "asyncio")


@contextmanager
def connected(scheduler: str | None, processes: int) -> Iterator["Client"]:
    """A client of the cluster of `scheduler`, or of a new one with `processes` workers on this machine.

    Raises:
        InputRefused: dask.distributed is not installed, nobody answers at that address, or there are no workers.
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
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False, name="twin-sweep")
        ends.callback(client.close, timeout=PATIENCE)
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
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
        scheduler = client.run_on_scheduler(versions)
        found = client.run(lack, sweep, on_error="return")
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
    """
    first = {reply.store: (address, reply.missing) for address, reply in found.items() if reply.missing}
    by_need: dict[tuple[str, ...], list[str]] = {}
    for address, missing in first.values():
        by_need.setdefault(missing, []).append(address)
    for missing, addresses in by_need.items():
        client.run(file_store.keep, {digest: contents[digest] for digest in missing}, workers=addresses)


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
        # in a thread of its own: in this one a notebook's event loop may be running already
        with ThreadPoolExecutor(1) as thread:
            found = thread.submit(asyncio.run, asyncio.wait_for(role(), PATIENCE)).result()
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
    import dask.config
    from distributed import LocalCluster

    with others_safe(), tempfile.TemporaryDirectory(prefix="twin_dask_") as folder:
        # Ctrl-C at a terminal reaches every process there; how a sweep stops is for us to say, so the workers, which
        # inherit what is blocked while they are started, do not hear it. It is heard here as soon as they are there.
        # Python's resource tracker, if it is started on the way, unblocks what was blocked, so it is started before.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with dask.config.set({"temporary-directory": folder}):
                cluster = LocalCluster(
                    n_workers=processes,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address=None,
                    # runs live in processes of their own, with a limit of their own
                    memory_limit=0,
                    silence_logs=SILENT,
                    # what is tried again is for us to say
                    scheduler_kwargs={"allowed_failures": 0},
                )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        with cluster:
            yield cluster


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
