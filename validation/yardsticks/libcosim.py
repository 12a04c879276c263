"""The robot in libcosim, out of an OspSystemStructure.xml as its users write it."""

from xml.etree import ElementTree as ET

from fmpy import read_model_description

from validation.masters.master import (
    BIT_FOR_BIT,
    FIG4,
    MASSAGE,
    ROUNDING,
    SAME_BITS,
    WHY_ROUNDING,
    Master,
    beside_a_loop,
    beside_the_twin,
)
from validation.masters.robot import Case, Robot, Rows, Signals

NAMESPACE = "http://opensimulationplatform.com/MSMI/OSPSystemStructure"


def structure(robot: Robot) -> bytes:
    """OspSystemStructure.xml. A function feeds one input only, so each wire with an offset has one of its own."""
    root = ET.Element("OspSystemStructure", xmlns=NAMESPACE, version="0.1")
    ET.SubElement(root, "StartTime").text = "0.0"
    ET.SubElement(root, "BaseStepSize").text = repr(robot.own.tick)
    ET.SubElement(root, "Algorithm").text = "fixedStep"
    simulators = ET.SubElement(root, "Simulators")
    for name, file in robot.files.items():
        simulator = ET.SubElement(simulators, "Simulator", name=name, source=file.name, stepSize=repr(robot.own.tick))
        values = ET.SubElement(simulator, "InitialValues")
        for variable, value in robot.parameters.get(name, {}).items():
            ET.SubElement(ET.SubElement(values, "InitialValue", variable=variable), "Real", value=repr(value))
    functions, connections = ET.SubElement(root, "Functions"), ET.SubElement(root, "Connections")
    for i, wire in enumerate(robot.wires):
        (source, output), (target, variable) = wire.source, wire.target
        first, second = {"simulator": source, "name": output}, {"simulator": target, "name": variable}
        if not wire.offset:
            connection = ET.SubElement(connections, "VariableConnection")
            ET.SubElement(connection, "Variable", first)
            ET.SubElement(connection, "Variable", second)
            continue
        ET.SubElement(functions, "LinearTransformation", name=f"shift_{i}", factor="1", offset=repr(wire.offset))
        connection = ET.SubElement(connections, "SignalConnection")
        ET.SubElement(connection, "Variable", first)
        ET.SubElement(connection, "Signal", function=f"shift_{i}", name="in")
        connection = ET.SubElement(connections, "SignalConnection")
        ET.SubElement(connection, "Signal", function=f"shift_{i}", name="out")
        ET.SubElement(connection, "Variable", second)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def run(given: Robot) -> Signals:
    """What libcosim gives.

    Raises:
        RuntimeError: libcosim refuses or fails.
    """
    from libcosimpy._internal import get_last_error_message
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.WARNING)
    (given.folder / "OspSystemStructure.xml").write_bytes(structure(given))
    execution = CosimExecution.from_osp_config_file(str(given.folder))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    seen = []
    rows = Rows(given)
    for name, file in given.files.items():
        variables = {v.name: v.valueReference for v in read_model_description(str(file)).modelVariables}
        references = [variables[output] for output in given.outputs[name]]
        seen.append((rows.values[name], execution.slave_index_from_instance_name(name), references))
    for k in range(given.ticks):
        if not execution.step():
            raise RuntimeError(f"step {k}: {get_last_error_message()}")
        for values, slave, references in seen:
            values[k + 1] = observer.last_real_values(slave, references)
    return rows.signals()


def time_of(tick: int) -> float:
    """As libcosim hands it on: whole nanoseconds, divided (s)."""
    return tick * 1_000_000 / 1_000_000_000


LIBCOSIM = Master(run, "libcosim, Open Simulation Platform", ("libcosimpy",))
NANOSECONDS = (
    "libcosim counts nanoseconds and hands on the difference of two times as a number, so that the last bits of a step "
    "vary, and the drives reckon with it"
)
POWER_OF_TWO = Case(
    "massage",
    62.0,
    ("cosim.tick_ms=1.953125", "controller.period_ms=3.90625", "monitor.period_ms=3.90625"),
    "in steps of 1/512 s",
)
"""Of such steps all times and their differences are exact."""
YARDSTICKS = (
    beside_the_twin(LIBCOSIM, FIG4, ROUNDING, f"{NANOSECONDS}; {WHY_ROUNDING}"),
    beside_a_loop(LIBCOSIM, FIG4, time_of, "counts nanoseconds"),
    beside_the_twin(LIBCOSIM, MASSAGE, ROUNDING, f"{NANOSECONDS}; {WHY_ROUNDING}"),
    beside_a_loop(LIBCOSIM, MASSAGE, time_of, "counts nanoseconds"),
    beside_the_twin(LIBCOSIM, POWER_OF_TWO, BIT_FOR_BIT, SAME_BITS),
)
