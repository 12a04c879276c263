"""What an FMU instance holds of a state: its inside by FMI's functions, and which of its messages were handed on."""

import json
from typing import Any

from twin.kernel.cache_folder import cache_base, cache_folder
from twin.kernel.errors import InputRefused
from twin.kernel.files import json_of
from twin.kernel.fmi.stepping import Instance, Stepping

DISTRUSTED = "without_state"
"""Folder of the cache: a file for each FMU, by its SHA-256, whose state was found not to bring back what it was."""


def distrust(sha256: str, reason: str) -> None:
    """From now on the FMU with this SHA-256 counts as one without a state, for every process of this user; "": no more.

    Args:
        sha256: of its file.
        reason: what was found.
    """
    file = cache_folder(DISTRUSTED) / sha256
    if reason:
        file.write_text(reason)
    else:
        file.unlink(missing_ok=True)


def is_distrusted(sha256: str) -> bool:
    """Whether that was found; nothing is made for the question."""
    return (cache_base() / DISTRUSTED / sha256).exists()


class FmuStates:
    """The states of an FMU's inside (FMI 2.0.4, 2.1.8; FMI 3.0, 2.2.5), a `Holder`: its tokens are their addresses.

    Args:
        instance: the FMU.
        stepping: how it is stepped. As long as there are tokens its steps announce that it may go back.
    """

    def __init__(self, instance: Instance, stepping: Stepping):
        self._instance, self._stepping = instance, stepping
        self._tokens: dict[int, Any] = {}

    def take(self) -> int:
        return self._hold(self._instance.taken_state())

    def give_back(self, token: int) -> None:
        self._instance.set_state(self._tokens[token])

    def free(self, token: int) -> None:
        if self._tokens.pop(token, None) is not None:
            if not self._tokens:
                self._stepping.memory["final"] = self._final
            self._instance.forget(token)

    def pack(self, token: int) -> bytes:
        return self._instance.serialized(self._tokens[token])

    def unpack(self, content: bytes) -> int:
        return self._hold(self._instance.deserialized(content))

    def close(self) -> None:
        """Free all states."""
        for token in list(self._tokens):
            self.free(token)

    def _hold(self, state: Any) -> int:
        if not self._tokens:
            self._final = int(self._stepping.memory["final"][0])
            self._stepping.repeat_steps()
        self._tokens[state.value] = state
        return int(state.value)


class RememberedMessages:
    """Which messages of an FMU were handed on, a `Holder`: its tokens are lists of them.

    Args:
        label: what a refusal begins with.
        instance: the FMU, which says each once.
        stepping: how it is stepped, where a discarded step is said once.
    """

    def __init__(self, label: str, instance: Instance, stepping: Stepping):
        self._label, self._instance, self._stepping = label, instance, stepping

    def take(self) -> list[Any]:
        return [*map(list, self._instance.remembered_messages()), self._stepping.discard_reported]

    def give_back(self, token: list[Any]) -> None:
        self._instance.restore_messages(token[:2])
        self._stepping.discard_reported = bool(token[2])

    def free(self, token: list[Any]) -> None:
        """Nothing is held."""

    def pack(self, token: list[Any]) -> bytes:
        return json.dumps(token).encode()

    def unpack(self, content: bytes) -> list[Any]:
        try:
            messages, unheard, reported = json_of(content, self._label)
            return [list(map(str, messages)), [(int(tick), str(text)) for tick, text in unheard], bool(reported)]
        except (TypeError, ValueError):
            raise InputRefused(f"{self._label}: no messages that twin saved") from None
