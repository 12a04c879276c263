"""What viewers ask of a run: to see and to change its parameters. Called by the server's own threads."""

import threading
from collections.abc import Callable

from foxglove import Parameter, ParameterType
from foxglove.websocket import ChannelView, Client, ServerListener

from twin.errors import InputRefused
from twin.execution.tuning import Tuning


class Listener(ServerListener):
    """Answers viewers.

    Args:
        refuse: told the sentence about a value that cannot be.

    Attributes:
        tuning: of the run that is on; None before the first.
        watched: set as soon as somebody has subscribed to a topic. newcomer: likewise, for whoever clears it.
    """

    def __init__(self, refuse: Callable[[str], None]):
        self.tuning: Tuning | None = None
        self.watched, self.newcomer = threading.Event(), threading.Event()
        self._refuse = refuse

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self.newcomer.set()
        self.watched.set()

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        return self._parameters(param_names)

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Ask for each; what the answer says of a refused one is the value that it keeps."""
        for parameter in parameters:
            try:
                if self.tuning is None:
                    raise InputRefused(f"{parameter.name}: no run is on yet; its parameters come with it")
                self.tuning.request(parameter.name, parameter.get_value())
            except InputRefused as refusal:
                self._refuse(f"refused: {refusal}")
        return self._parameters([parameter.name for parameter in parameters])

    def _parameters(self, names: list[str]) -> list[Parameter]:
        """Those of `names` that there are; all of them if there are no names."""
        values = self.tuning.values() if self.tuning else {}
        # a whole number would come back as one, and then never again take a fraction
        return [
            Parameter(name, value=value, type=ParameterType.Float64)
            for name, value in values.items()
            if name in names or not names
        ]
