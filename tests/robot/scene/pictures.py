"""What a viewer gets out of a recording, read by the mcap package and protobuf, not by twin."""

from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation


def messages(path: Path, topic: str) -> list[tuple[int, Any]]:
    """Log time (ns) and message of everything on `topic`, with every CRC checked."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(message.log_time, decoded) for _, _, message, decoded in reader.iter_decoded_messages(topic)]


def numbers(position: Any, orientation: Any) -> list[float]:
    """Position and quaternion (x, y, z, w), 7 numbers."""
    return [*(getattr(position, axis) for axis in "xyz"), *(getattr(orientation, axis) for axis in "xyzw")]


def frames(path: Path) -> dict[str, NDArray[np.float64]]:
    """Child frame -> its poses in the base frame, (messages, 7)."""
    found: dict[str, list[list[float]]] = {}
    for _, message in messages(path, "/tf"):
        for transform in message.transforms:
            assert transform.parent_frame_id == "base"
            found.setdefault(transform.child_frame_id, []).append(numbers(transform.translation, transform.rotation))
    return {frame: np.array(poses) for frame, poses in found.items()}


def at(poses: NDArray[np.float64], point: tuple[float, float, float]) -> NDArray[np.float64]:
    """Where `point` (m) of frames at `poses` (n, 7) is in the base frame, (n, 3)."""
    return poses[:, :3] + Rotation.from_quat(poses[:, 3:]).apply(point)
