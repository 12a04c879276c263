"""The robot in libcosim, out of an OspSystemStructure.xml as its users write it."""

from collections.abc import Mapping
from functools import cache, partial
from xml.etree import ElementTree as ET

from fmpy import read_model_description

from validation.masters.bounds import DURATIONS, RANGE, RANGE_REASON, RANGE_UNIT
from validation.masters.plain_loop import looped
from validation.masters.robot import Robot, Rows, Signals, differences, robot
from validation.yardstick import Yardstick

NAMESPACE = "http://opensimulationplatform.com/MSMI/OSPSystemStructure"
NANOSECONDS = 1_000_000_000


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


@cache
def run(experiment: str) -> Signals:
    """What libcosim gives for an experiment.

    Raises:
        RuntimeError: libcosim refuses or fails.
    """
    from libcosimpy._internal import get_last_error_message
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.WARNING)
    given = robot(experiment, DURATIONS[experiment])
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


def beside_the_twin(experiment: str) -> Mapping[str, float]:
    return differences(run(experiment), robot(experiment, DURATIONS[experiment]).own)


def explained() -> Mapping[str, float]:
    """libcosim beside a plain loop that counts time as it does, in whole nanoseconds: the last bit of a step differs."""
    again = looped(robot("fig4_force_position", DURATIONS["fig4_force_position"]), libcosims_time)
    theirs = run("fig4_force_position")
    return {key: float(abs(theirs[key][1:] - again[key][1:]).max()) for key in theirs}


def libcosims_time(tick: int) -> float:
    """Of an instant between two steps of 1 ms, s."""
    return tick * 1_000_000 / NANOSECONDS


SOURCE = "libcosim of the Open Simulation Platform (DNV, SINTEF, Kongsberg, NTNU), in libcosimpy"
YARDSTICKS = (
    *(
        Yardstick(
            claim=f"{duration:g} s of {experiment}: every output of drives, plant and computer beside the twin's own run",
            source=SOURCE,
            unit=RANGE_UNIT,
            bound=RANGE,
            reason=RANGE_REASON + "libcosim counts whole nanoseconds and hands on the difference of two times as numbers, "
            "so that a step is not always the same 0.001 s in its last bit; the drives reckon with it",
            differences=partial(beside_the_twin, experiment),
            packages=("libcosimpy",),
        )
        for experiment, duration in DURATIONS.items()
    ),
    Yardstick(
        claim="20 s of fig4_force_position beside a plain loop that counts time in nanoseconds: that is all there is to it",
        source=SOURCE,
        unit="",
        bound=0.0,
        reason="the same FMUs, the same numbers on the wires, the same steps: the same bits",
        differences=explained,
        packages=("libcosimpy",),
    ),
)
