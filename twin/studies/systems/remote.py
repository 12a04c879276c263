"""Components of a system on other machines: their FMUs live beside Dask workers there, and a step is a question.

Dask carries it: it is kept by many, twin's sweeps use it already, and it has TLS with certificates on both sides. Only
the FMU and numbers go there; nothing of the robot, the system or the recording does.
"""

import ctypes
import ipaddress
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np

from twin.kernel.compiled.machine import chosen_form
from twin.kernel.cosim.component import Component, Holder, Rewind
from twin.kernel.cosim.port import width
from twin.kernel.cosim.python_class import FAILED as STATUS
from twin.kernel.cosim.python_class import STEP, doubles
from twin.kernel.errors import ComponentFailed, InputRefused, TwinError
from twin.kernel.fmi.groups import TERMINATE
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.solvers import Solver
from twin.kernel.fmi.stepping import at_both_ends, placed
from twin.kernel.fmi.variable import Setting, Setup, Variable
from twin.kernel.process.hosted import DONE, ENDED, LOADING, RESTORE, SAVE, HostedFmu
from twin.kernel.process.job import error_of
from twin.kernel.process.reporter import Elsewhere
from twin.kernel.systems.coupling import Host
from twin.kernel.systems.plan import SystemPart
from twin.studies.sweep.dask.cluster import ClusterLost, connected

if TYPE_CHECKING:
    from distributed import Client

WAY = 5.0
"""How long (s) there and back may take, beside the longest call into an FMU."""


class ConnectionGone(ComponentFailed):
    """A machine that does not answer any more."""


@contextmanager
def machines(remote: Mapping[str, str], limit: float) -> Iterator[dict[str, Host]]:
    """Where components live, by path; connected when the first of an address is made.

    Args:
        remote: address of a Dask scheduler by the path of a component.
        limit: longest time of one call into an FMU (s).

    Raises:
        InputRefused: an address that others could listen to, or none.
    """
    for path, address in remote.items():
        _refuse_open(f"--remote {path}={address}", address)
    with ExitStack() as connections:
        clients: dict[str, Client] = {}

        def client(address: str) -> "Client":
            if address not in clients:
                clients[address] = connections.enter_context(_client(address))
            return clients[address]

        yield {path: RemoteHost(address, client, limit) for path, address in remote.items()}


@contextmanager
def _client(address: str) -> "Iterator[Client]":
    with ExitStack() as ends:
        try:
            client = ends.enter_context(connected(address, 0))
        except (InputRefused, ClusterLost) as problem:
            text = str(problem).replace("--scheduler", "--remote").replace("--engine dask", "--remote")
            raise InputRefused(text) from None
        # else each call takes the way by the scheduler
        client.direct_to_workers = True
        yield client


def _refuse_open(where: str, address: str) -> None:
    """Dask runs what anybody sends who reaches its port; TLS lets only those do so who have a certificate."""
    with suppress(ValueError):
        parts = urlsplit(address)
        if parts.scheme == "tls" and parts.hostname and parts.port:
            return
        if parts.scheme == "tcp" and parts.hostname and parts.port:
            if parts.hostname == "localhost" or ipaddress.ip_address(parts.hostname).is_loopback:
                return
            raise InputRefused(
                f"{where}: tcp leaves this machine unencrypted, and anybody who reaches that port can run code there; "
                "start scheduler and worker with certificates, and give tls://"
            )
    raise InputRefused(f"{where}: expected NAME=tls://HOST:PORT, or tcp://127.0.0.1:PORT, of a Dask scheduler")


class RemoteHost:
    """A machine for one component; see `Host`.

    Args:
        address: of the scheduler.
        client: of an address.
        limit: longest time of one call (s).
    """

    def __init__(self, address: str, client: "Callable[[str], Client]", limit: float):
        self.address, self._client, self._limit = address, client, limit
        self._content = b""

    def take(self, content: bytes) -> None:
        self._content = content

    def opened(self, part: SystemPart, setup: Setup) -> "RemoteInstance":
        client = self._client(self.address)
        try:
            workers = sorted(client.scheduler_info(n_workers=-1)["workers"])
            place = workers[0]
            _refuse_open(f"--remote {part.path}={self.address}: its worker {place}", place)
            actor = client.submit(
                HostedFmu, self._limit, actor=True, pure=False, workers=[place], allow_other_workers=False
            )
            # an actor belongs to the client that is current where it arrives
            with client.as_current():
                instance = RemoteInstance(part, setup, place, actor.result(WAY + LOADING), self._limit)
        except (OSError, TimeoutError, IndexError) as problem:
            raise InputRefused(f"--remote {part.path}={self.address}: {_reason(problem, WAY + LOADING)}") from None
        instance.make(self._content)
        return instance


class RemoteInstance(Instance):
    """An FMU instance on another machine.

    Args:
        part: of the system.
        setup: of the run.
        place: address of the worker.
        actor: that has the instance.
        limit: longest time of one call (s).
    """

    def __init__(self, part: SystemPart, setup: Setup, place: str, actor: Any, limit: float):
        self.part, self.place, self._actor, self._limit = part, place, actor, limit
        self.description, self.name, self.setup, self.settings = part.description, part.path, setup, part.settings
        self.messages, self.missing, self.processor = [], [], ""
        self.gone = False

    def make(self, content: bytes) -> None:
        """Send it the FMU.

        Raises:
            InputRefused: it cannot be made there.
        """
        part = self.part
        values = {v.name: value for v, value in part.settings if isinstance(value, float)}
        try:
            facts = self.result(
                lambda: self._actor.make(
                    content, part.description.path.name, name=part.path, kind=part.description.kind, values=values,
                    settings=list(part.settings), setup=self.setup,
                ),
                LOADING,
            )  # fmt: skip
        except ComponentFailed as failure:
            raise InputRefused(f"{part.description.path.name} ({part.path}) {failure}") from None
        self.missing, self.processor = facts["missing"], facts["processor"]

    def ask(self, what: str, **order: Any) -> Any:
        """The result of a call there.

        Raises:
            ConnectionGone: it does not answer.
            TwinError: what it raised; an end of its process is a ComponentFailed.
        """
        return self.result(lambda: self._actor.call(what, **order))

    def result(self, begin: Callable[[], Any], loading: float = 0.0) -> Any:
        """What a call of the actor comes to, which may take the limit, or `loading` (s) if that is more; see `ask`."""
        patience = WAY + max(self._limit, loading)
        try:
            outcome, came = begin().result(patience)
        # of Dask there may be any, where a worker has gone
        except Exception as problem:
            self.gone = True
            raise ConnectionGone(f"lost the connection to {self.place}: {_reason(problem, patience)}") from None
        if outcome == DONE:
            return came
        self.gone = True
        if outcome == ENDED:
            raise ComponentFailed(f"{came} at {self.place}")
        raise error_of(came)

    def read(self, variables: Sequence[Variable]) -> np.ndarray:
        return np.frombuffer(bytes.fromhex(self.ask("read", variables=list(variables))))

    def write(self, settings: Sequence[Setting]) -> None:
        self.ask("write", settings=list(settings))

    def begin(self) -> None:
        """With the component, which is made in the same call."""

    def close(self) -> None:
        if not self.gone:
            self.gone = True
            with suppress(Exception):
                self._actor.call("close").result(WAY)

    def ramps(self, variable: Variable) -> bool:
        return self.description.kind == "co_simulation" and super().ramps(variable)

    def component(self, period: int, solver: Solver) -> Component:
        return RemoteComponent(self, period, solver)


class RemoteComponent(Elsewhere):
    """Stands for an FMU on another machine, where its states stay; as a `Holder` its tokens are their numbers.

    Saving a state before a step, and going back to it, travel with that step: one way there and back for each.

    Args:
        instance: that is initialised.
        period: in ticks.
        solver: of its equations, there, if it is for model exchange.

    Attributes:
        whole: as a `Holder` it packs the state of the whole component, which is that of one in this process.
        ports: as of `FmuComponent`.
    """

    whole = True

    def __init__(self, instance: RemoteInstance, period: int, solver: Solver):
        part = instance.part
        self._instance, self._why, own = instance, "", chosen_form().name
        self._events: list[tuple[int, str]] = []
        if instance.processor != own:
            self._events.append(
                (0, f"its machine has the processor form {instance.processor}, this one {own}: other bits")
            )
        self._clock = np.zeros(1, dtype=np.int64)
        self._callbacks: dict[str, Any] = {}
        ports = {"inputs": list(part.inputs), "outputs": list(part.outputs), "settings": list(part.settings)}
        begun = instance.ask("begin", name=part.name, solver=solver, **ports)
        self.function = f"{begun['called']} at {instance.place}"
        self._lacks: list[str] = begun["lacks"]
        self.ports = at_both_ends(instance, part.inputs), placed(part.outputs)
        inputs, outputs = tuple(p.port for p in self.ports[0]), tuple(p.port for p in part.outputs)
        self._sizes = width(inputs), width(outputs)
        self._before: list[str] = []
        super().__init__(
            name=part.name,
            inputs=inputs,
            outputs=outputs,
            sampled=False,
            step_address=self._callback("step", self._step),
            self_address=0,
            initial_outputs=np.frombuffer(bytes.fromhex(begun["y"])),
            period=period,
            label=part.description.path.name,
            keep=self._callbacks,
        )

    def _step(self, _self: int, t: float, h: float, u: int, y: int, reacts: bool = False) -> int:
        count, results = self._sizes
        before, self._before = self._before, []
        given = np.array(doubles(u, count)).tobytes().hex()
        try:
            came = self._instance.ask("step", t=t, h=h, u=given, before=before, reacts=reacts)
        # what leaves a callback would be printed and lost
        except BaseException as problem:
            self._why = str(problem)
            return STATUS
        doubles(y, results)[:] = np.frombuffer(bytes.fromhex(came["y"]))
        self._events += [(int(self._clock[0]), text) for text in came["messages"]]
        self._why = came["why"]
        return int(came["status"])

    def explain(self, status: int) -> str:
        return self._why or super().explain(status)

    def asks_to_end(self, status: int) -> bool:
        return status == TERMINATE

    def reaction(self) -> int:
        if self._instance.description.kind != "model_exchange":
            return 0
        return self._callback("react", partial(self._step, reacts=True))

    def rewind(self) -> Rewind | None:
        if not self._instance.ask("rewind"):
            return None
        save, restore = (self._callback(what, partial(self._note, what)) for what in (SAVE, RESTORE))
        return Rewind(save, restore, 0, self)

    def _callback(self, name: str, call: Callable[..., int]) -> int:
        """Address of a function of a step's signature; it lives as long as this."""
        # one that was given away stays
        self._callbacks.setdefault(name, STEP(call))
        return ctypes.cast(self._callbacks[name], ctypes.c_void_p).value or 0

    def _note(self, what: str, *_: Any) -> int:
        self._before.append(what)
        return 0

    def holders(self) -> dict[str, Holder]:
        return {"there": self}

    def lacks_state(self, portable: bool = True) -> str:
        return self._lacks[portable]

    def take(self) -> int:
        return int(self._asked("take"))

    def give_back(self, token: int) -> None:
        self._asked("give_back", number=token)

    def free(self, token: int) -> None:
        # without a connection its process has gone, or will, and with it the state
        if not self._instance.gone:
            with suppress(TwinError):
                self._asked("free", number=token)

    def pack(self, token: int) -> bytes:
        return bytes.fromhex(self._asked("pack", number=token))

    def unpack(self, content: bytes) -> int:
        return int(self._asked("unpack", content=content.hex()))

    def _asked(self, what: str, **order: Any) -> Any:
        try:
            return self._instance.ask(what, **order)
        except ComponentFailed as failure:
            raise ComponentFailed(f"{self.label} ({self.name}) {failure}") from None

    def keep_time(self, clock: np.ndarray) -> None:
        self._clock = clock

    def take_messages(self) -> list[tuple[int, str]]:
        heard, self._events = self._events, []
        return heard

    def close(self) -> None:
        self._instance.close()


def _reason(problem: BaseException, patience: float) -> str:
    """Why there is no answer, of which `patience` (s) had been waited for."""
    text = str(problem).strip().splitlines()
    if isinstance(problem, TimeoutError):
        return f"no answer within {patience:g} s"
    return f"{type(problem).__name__}: {text[0]}" if text else type(problem).__name__
