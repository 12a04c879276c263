"""Recording topics of a system: one per component, with array elements joined to one signal."""

from twin.kernel.errors import InputRefused
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.recording.messages import Field, Topic, message_names
from twin.kernel.recording.recorder import RowStream, port_fields
from twin.kernel.systems.coupling import PreparedSystem
from twin.kernel.systems.naming import field_name, split_element, unique_names
from twin.kernel.systems.plan import SystemPart, SystemPlan


def streams(plan: SystemPlan, made: PreparedSystem) -> list[RowStream]:
    """Return the topics of a system's recording with their columns of a row, in component order."""
    found = []
    for topic in topics(plan):
        first = made.columns[topic.name].start
        # unrecorded outputs come after the recorded ones
        found.append(RowStream(topic, slice(first, first + sum(field.size for field in topic.fields))))
    return found


def topics(plan: SystemPlan) -> list[Topic]:
    """Return the recording's topics for the outputs of a planned system."""
    found = [Topic(one.name, port_fields(one.outputs), 1) for one in plan.extras.components if one.outputs]
    found += [Topic(part.name, tuple(_fields(part)), 1) for part in plan.parts if part.recorded]
    try:
        message_names(found)
    except ValueError as problem:
        raise InputRefused(f"{plan.package.file}: {problem}; give components names that are less alike") from None
    return found


def _fields(part: SystemPart) -> list[Field]:
    groups = _arrays(part.outputs[: part.recorded])
    names = unique_names(
        field_name(split_element(group[0].variable.name)[0] if len(group) > 1 else group[0].variable.name, part.path)
        for group in groups
    )
    return [
        Field(name, sum(p.port.size for p in group), group[0].port.kind, group[0].port.unit, group[0].port.meaning)
        for name, group in zip(names, groups, strict=True)
    ]


def _arrays(ports: tuple[FmuPort, ...]) -> list[list[FmuPort]]:
    """Group consecutive ports `X[1]`, `X[2]` ... of equal type and unit, which form an array."""
    groups: list[list[FmuPort]] = []
    for port in ports:
        array, number = split_element(port.variable.name)
        last = groups[-1] if groups else []
        like = last and (last[0].port.kind, last[0].port.unit) == (port.port.kind, port.port.unit)
        if (
            like
            and split_element(last[0].variable.name) == (array, 1)
            and number == len(last) + 1
            and port.port.size == 1
        ):
            last.append(port)
        else:
            groups.append([port])
    return groups
