"""The job of `twin run --live`: as without, and served."""

from typing import Any

from twin.errors import InputRefused
from twin.guard.runs import recorded_runs
from twin.guard.voice import Voice


def served_runs(voice: Voice, port: int, **arguments: Any) -> None:
    """Run experiments as `recorded_runs` does while viewers watch; the first begins when somebody does.

    Notes: {"serving": address} before all others.

    Args:
        port: see `LiveServer`.
        arguments: of `recorded_runs`.

    Raises:
        InputRefused: foxglove-sdk is not installed, or the port is taken.
        TwinError: as `recorded_runs`.
    """
    try:
        from twin.live.server import LiveServer
    except ImportError as missing:
        if missing.name != "foxglove":
            raise
        raise InputRefused("--live: foxglove-sdk is not installed; pip install 'twin[live]'") from None
    with LiveServer(port) as server:
        voice.note(serving=server.address)
        recorded_runs(voice, **arguments, viewer=server)
