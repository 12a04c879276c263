"""The test rig for FMI 3.0 drives: the same few verbs as rig.py, for variables of several types."""

from typing import Any, Self

from fmpy.fmi3 import FMU3Slave

from .rig import Stepped, described, unpacked


class Rig3(Stepped):
    """One instance of an FMI 3.0 drive; values are read and set by variable name, whatever their type.

    Attributes:
        slave: the FMPy object, for calls this class does not cover.
        messages: (status, text) of everything the FMU logged.
        time: the communication point reached, s.
    """

    def __init__(self, drive: str, token: str | None = None, event_mode: bool = False):
        self.messages: list[tuple[int, str]] = []
        self.time = 0.0
        description = described(drive)
        self.variables = {v.name: v for v in description.modelVariables}
        self.slave = FMU3Slave(
            guid=token or description.instantiationToken,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=unpacked(drive),
            instanceName=drive,
        )
        self.slave.instantiate(eventModeUsed=event_mode, logMessage=self._log)

    def _log(self, environment: int, status: int, category: bytes, text: bytes) -> None:
        self.messages.append((status, text.decode()))

    def start(self, **values: float) -> Self:
        """Set start values and go through initialisation mode."""
        for name, value in values.items():
            self[name] = value
        self.slave.enterInitializationMode(startTime=self.time)
        self.slave.exitInitializationMode()
        return self

    def values(self) -> dict[str, Any]:
        """All variables by name."""
        return {name: self[name] for name in self.variables}

    def __getitem__(self, name: str) -> Any:
        variable = self.variables[name]
        return getattr(self.slave, f"get{variable.type}")([variable.valueReference])[0]

    def __setitem__(self, name: str, value: float) -> None:
        variable = self.variables[name]
        getattr(self.slave, f"set{variable.type}")([variable.valueReference], [value])
