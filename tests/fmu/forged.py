"""Restore states of a drive that are odd in one place: `python -m tests.fmu.forged DRIVE FOLDER`, a line per state.

Run as a process of its own, because a drive that believed such a state might crash.
"""

import struct
import sys
from collections.abc import Iterator
from pathlib import Path

from builder.drive import folder_of, load_drive
from fmpy import extract, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

MODES = (0, 1, 3, 4, 255, 2**31 - 1, -1, -(2**31))
NUMBERS = (float("nan"), float("inf"), float("-inf"), -1e300, 1e300, 2.0**31, 0.5, -1.0, 7.0, 5e-324)


def odd_states(state: bytes, places: list[str]) -> Iterator[tuple[str, float, bytes]]:
    """Name, odd value and bytes of states that differ from `state` in one place."""
    for mode in MODES:
        yield "mode", mode, struct.pack("<i", mode) + state[4:]
    for place, name in enumerate(places, start=1):
        for value in NUMBERS:
            yield name, value, state[: 8 * place] + struct.pack("<d", value) + state[8 * place + 8 :]


def restored(drive: str, folder: Path) -> Iterator[str]:
    """`NAME VALUE refused` or `NAME VALUE restored`, of every odd state."""
    file = folder_of(drive) / f"{drive}.fmu"
    model = read_model_description(str(file), validate=False)
    kind = FMU3Slave if model.fmiVersion.startswith("3") else FMU2Slave
    slave = kind(
        guid=model.guid or model.instantiationToken,
        unzipDirectory=extract(str(file), unzipdir=folder),
        modelIdentifier=model.coSimulation.modelIdentifier,
        instanceName=drive,
    )
    slave.instantiate()
    if kind is FMU2Slave:
        slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for tick in range(5):
        slave.doStep(tick * 1e-3, 1e-3)
    get, put, free, pack, unpack = (
        ("getFMUState", "setFMUState", "freeFMUState", "serializeFMUState", "deserializeFMUState")
        if kind is FMU3Slave
        else ("getFMUstate", "setFMUstate", "freeFMUstate", "serializeFMUstate", "deSerializeFMUstate")
    )
    sound = getattr(slave, get)()
    bytes_of_it = getattr(slave, pack)(sound)
    for name, value, odd in odd_states(bytes_of_it, ["time", *(v.name for v in load_drive(drive).variables)]):
        try:
            state = getattr(slave, unpack)(odd)
        except FMICallException:
            yield f"{name} {value!r} refused"
            continue
        yield f"{name} {value!r} restored"
        getattr(slave, put)(state)
        try:
            for tick in range(5, 8):
                slave.doStep(tick * 1e-3, 1e-3)
        except FMICallException:
            pass
        getattr(slave, put)(sound)
        getattr(slave, free)(state)
    yield "end"


if __name__ == "__main__":
    for line in restored(sys.argv[1], Path(sys.argv[2])):
        print(f"> {line}", flush=True)
