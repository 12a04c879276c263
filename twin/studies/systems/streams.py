"""A topic for each component of a system: its outputs, elements of an array as one signal again."""

from twin.cosim.system import System
from twin.drive.stepping import FmuPort
from twin.errors import InputRefused
from twin.recording.layout import Field, Topic
from twin.recording.schema import message_names
from twin.runs.streams import RowStream
from twin.studies.systems.naming import distinct, element, field
from twin.studies.systems.plan import Part, Plan


def streams(plan: Plan, system: System) -> list[RowStream]:
    """In the order of the components; none of one that has no outputs."""
    columns = {
        part.name: slice(int(system.y_start[c]), int(system.y_start[c + 1])) for c, part in enumerate(plan.parts)
    }
    return [RowStream(topic, columns[topic.name]) for topic in topics(plan)]


def topics(plan: Plan) -> list[Topic]:
    """The same before there is a system.

    Raises:
        InputRefused: two components have names that a recording cannot tell apart.
    """
    found = [Topic(part.name, tuple(_fields(part)), 1) for part in plan.parts if part.outputs]
    try:
        message_names(found)
    except ValueError as problem:
        raise InputRefused(f"{plan.package.file}: {problem}; give components names that are less alike") from None
    return found


def _fields(part: Part) -> list[Field]:
    groups = _arrays(part.outputs)
    names = distinct(field(element(group[0].variable.name)[0] if len(group) > 1 else group[0].variable.name, part.path)
                     for group in groups)  # fmt: skip
    return [
        Field(name, sum(p.port.size for p in group), group[0].port.kind, group[0].port.unit, group[0].port.meaning)
        for name, group in zip(names, groups, strict=True)
    ]


def _arrays(ports: tuple[FmuPort, ...]) -> list[list[FmuPort]]:
    """Ports one after the other, `X[1]`, `X[2]` .. of one kind and unit together."""
    groups: list[list[FmuPort]] = []
    for port in ports:
        array, number = element(port.variable.name)
        last = groups[-1] if groups else []
        like = last and (last[0].port.kind, last[0].port.unit) == (port.port.kind, port.port.unit)
        if like and element(last[0].variable.name) == (array, 1) and number == len(last) + 1 and port.port.size == 1:
            last.append(port)
        else:
            groups.append([port])
    return groups
