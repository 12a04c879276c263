"""The job of `twin run --live`: as without, and served."""

from typing import Any

from twin.kernel.errors import InputRefused
from twin.kernel.process.reporter import Reporter
from twin.robot.run.isolated_runs import recorded_runs


def served_runs(reporter: Reporter, port: int, origins: list[str], **arguments: Any) -> None:
    """Run experiments as `recorded_runs` does while viewers watch; each begins when somebody does.

    Notes: {"serving": address} when a run waits for its first viewer; {"refused": sentence} about a connection that
    was, meanwhile; the others are those of `recorded_runs`.

    Args:
        port, origins: see `LiveServer`.
        arguments: of `recorded_runs`.

    Raises:
        InputRefused: websockets is not installed, the port is taken, or an origin is none.
        TwinError: as `recorded_runs`.
    """
    try:
        from twin.robot.live.server import LiveServer
    except ImportError as missing:
        if not (missing.name or "").startswith("websockets"):
            raise
        raise InputRefused("--live: websockets is not installed; pip install 'websockets>=14'") from None

    with LiveServer(
        port,
        announce=lambda address: reporter.note(serving=address),
        warn=lambda sentence: reporter.note(refused=sentence),
        origins=origins,
    ) as server:
        recorded_runs(reporter, **arguments, viewer=server)
