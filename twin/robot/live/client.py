"""One viewer that is connected: what it has subscribed to, what it asks, and what it may."""

import asyncio
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from twin.kernel.errors import InputRefused
from twin.kernel.live import protocol
from twin.kernel.live.protocol import Channel, Level, Message, message_data, status, time_now
from twin.robot.run.tuning import Tuning

BACKLOG = 1024
"""Messages that wait for a viewer that is too slow; after that it loses the oldest."""
WATCHES = "refused: this viewer watches only; to tune, open the address that twin has printed, with its token"


class Client:
    """Lives in the server's event loop.

    Args:
        connection: to the viewer.
        may_tune: whether it may change parameters.
        channels: by their numbers.
        tuning: of the run.
        subscribed: called when its subscriptions have changed, with whether there are more of them.
        changed: called with the parameters that it has asked to change.

    Attributes:
        subscriptions: by channel, the number that the viewer has given it.
        lacking: those of them that never change and of which it has been handed nothing yet.
    """

    def __init__(
        self,
        connection: ServerConnection,
        may_tune: bool,
        channels: Mapping[int, Channel],
        tuning: Tuning,
        subscribed: Callable[[bool], None],
        changed: Callable[[Sequence[str]], None],
    ):
        self.subscriptions: dict[int, int] = {}
        self.lacking: set[int] = set()
        self._connection, self._may_tune, self._channels = connection, may_tune, channels
        self._tuning, self._subscribed, self._changed = tuning, subscribed, changed
        self._follows: set[str] = set()
        # what comes only once must not be among what gets lost
        self._once: dict[int, bytes] = {}
        self._waiting: deque[str | bytes | None] = deque(maxlen=BACKLOG)
        self._ready = asyncio.Event()
        self._sending = asyncio.create_task(self._send())

    async def attend(self, greeting: Sequence[str]) -> None:
        """Say the `greeting`, then answer until it leaves."""
        try:
            for told in greeting:
                await self._connection.send(told)
            # answers are waited for, so whoever does not read them is not heard any more
            async for said in self._connection:
                for answer in self._answers(said):
                    await self._connection.send(answer)
        except ConnectionClosed:
            pass
        finally:
            self._sending.cancel()

    def hand(self, time: int, messages: Sequence[Message]) -> None:
        """Send it the simulated `time` (ns), and what it has subscribed to of `messages`."""
        found, sent = self.subscriptions, [time_now(time)]
        for message in messages:
            if message.channel in self.lacking:
                self.lacking.remove(message.channel)
                self._once[message.channel] = message_data(found[message.channel], message)
            elif message.channel in found and not self._channels[message.channel].constant:
                sent.append(message_data(found[message.channel], message))
        self._put(*sent)

    def tell(self, names: Sequence[str]) -> None:
        """Send it what has become of those of the parameters `names` that it follows."""
        if wanted := self._follows.intersection(names):
            self._put(protocol.parameter_values(self._values(wanted)))

    async def farewell(self, patience: float) -> None:
        """Send what is waiting and say goodbye; after `patience` (s) it is left as it is."""
        self._put(None)
        await asyncio.wait([self._sending], timeout=patience)

    def cut_off(self) -> None:
        """End the connection; what was not sent is lost. Everything that waits for the viewer ends with it."""
        self._connection.transport.abort()

    def _put(self, *messages: str | bytes | None) -> None:
        self._waiting.extend(messages)
        self._ready.set()

    async def _send(self) -> None:
        try:
            while True:
                await self._ready.wait()
                self._ready.clear()
                while self._once or self._waiting:
                    message = self._once.popitem()[1] if self._once else self._waiting.popleft()
                    if message is None:
                        await self._connection.close(1001)
                        return
                    await self._connection.send(message)
        except ConnectionClosed:
            pass

    def _answers(self, said: str | bytes) -> list[str]:
        if isinstance(said, bytes):
            return [status(Level.ERROR, "not understood: nothing binary is expected here")]
        try:
            return self._answer(protocol.request(said))
        except InputRefused as refusal:
            return [status(Level.ERROR, str(refusal))]

    def _answer(self, asked: protocol.Request) -> list[str]:
        match asked:
            case protocol.Subscribe():
                return self._subscribe(asked)
            case protocol.Unsubscribe():
                left = {c: number for c, number in self.subscriptions.items() if number not in asked.ids}
                self.subscriptions = left
                self.lacking &= left.keys()
                self._subscribed(False)
            case protocol.AskParameters():
                return [protocol.parameter_values(self._values(asked.names), asked.id)]
            case protocol.SetParameters():
                return self._set(asked)
            case protocol.FollowParameters(op="subscribeParameterUpdates"):
                self._follows |= self._values(asked.names).keys()
            case protocol.FollowParameters():
                self._follows -= self._values(asked.names).keys()
        return []

    def _subscribe(self, asked: protocol.Subscribe) -> list[str]:
        answers, before = [], len(self.subscriptions)
        for wanted in asked.subscriptions:
            if wanted.channel not in self._channels:
                answers.append(status(Level.ERROR, f"there is no channel {wanted.channel}"))
            elif wanted.channel in self.subscriptions:
                answers.append(status(Level.WARNING, f"already subscribed to channel {wanted.channel}"))
            else:
                self.subscriptions[wanted.channel] = wanted.id
                if self._channels[wanted.channel].constant:
                    self.lacking.add(wanted.channel)
        if len(self.subscriptions) > before:
            self._subscribed(True)
        return answers

    def _set(self, asked: protocol.SetParameters) -> list[str]:
        """What the answer says of a refused one is the value that it keeps."""
        answers, names = [], [wish.name for wish in asked.parameters]
        if self._may_tune:
            for wish in asked.parameters:
                try:
                    self._tuning.request(wish.name, wish.value)
                except InputRefused as refusal:
                    answers.append(status(Level.WARNING, f"refused: {refusal}"))
            self._changed(names)
        else:
            answers.append(status(Level.WARNING, WATCHES))
        if asked.id is not None and names:
            answers.append(protocol.parameter_values(self._values(names), asked.id))
        return answers

    def _values(self, names: Collection[str]) -> dict[str, float]:
        """Of those of `names` that there are; of all if there are no names."""
        return {name: value for name, value in self._tuning.values().items() if name in names or not names}
