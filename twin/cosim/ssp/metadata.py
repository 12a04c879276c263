"""What SSP files tell of themselves: who made them, and notes of tools that others may pass over."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Annotation:
    """A note.

    Attributes:
        type: its name, by reversed domain: "org.openmodelica".
        content: XML of what is in it, "" for nothing.
    """

    type: str
    content: str = ""


@dataclass(frozen=True)
class Metadata:
    """Of a file (SSP 1.0, 4.4.2); "" is not stated. `generated` is a date and time as xs:dateTime."""

    description: str = ""
    author: str = ""
    version: str = ""
    copyright: str = ""
    license: str = ""
    tool: str = ""
    generated: str = ""
