"""An FMU brought to where it can be stepped, whatever kind it is of."""

from collections.abc import Sequence
from pathlib import Path

from twin.drive.description import FmuDescription
from twin.drive.exchange.model import Model
from twin.drive.instance import Instance
from twin.drive.setting import Setting
from twin.drive.setup import Setup


def opened(
    name: str,
    description: FmuDescription,
    folder: Path,
    settings: Sequence[Setting] = (),
    inputs: Sequence[Setting] = (),
    setup: Setup = Setup(),  # noqa: B008, it is frozen
) -> Instance:
    """A new instance; arguments as those of `Instance`.

    Raises:
        InputRefused: it cannot be loaded, instantiated or initialised.
    """
    kind = Model if description.kind == "model_exchange" else Instance
    return kind(name, description, folder, settings, inputs, setup)
