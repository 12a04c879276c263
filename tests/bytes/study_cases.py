"""Cases of what came after 1.0: shadow, replay of a log, branches, safety, systems, the explorer's answers.

All are short: a run of 8 s, or the first seconds of a log of it.
"""

from tests.bytes.case import FIG4, FIG4_SHORT, Case

FOUR = f"run {FIG4} --set duration_s=7 --isolate none --out a"
LOG = "export a --csv --rate 500 --out robot.csv" + "".join(
    f" --signals {name}" for name in ("encoder.count_m", "encoder.count_l", "controller.omega_ref", "scale.F_z")
)
"""The robot's log of the run in `a`."""
SPOILED = """import math
head, *rows = open("robot.csv").read().splitlines()
def written(name, rows):
    open(name, "w").write("\\n".join([head, *rows]) + "\\n")
written("gap.csv", [row for row in rows if not 3.0 < float(row.split(",")[0]) < 3.4])
written("nan.csv", [row if n % 97 else ",".join([row.split(",")[0], "nan", *row.split(",")[2:]])
                    for n, row in enumerate(rows, 1)])
open("cut.csv", "w").write("\\n".join([head, *rows, rows[-1][:25]]))
written("count_free.csv", [",".join(row.split(",")[:1] + row.split(",")[7:]) for row in rows])
"""
"""Logs as robots leave them: with a gap, with counts that are no number, with a line that was cut."""
FLEET = """experiment = "TREE/experiments/fig4_force_position.toml"
runs = 2
design = "latin_hypercube"
seed = 35
[[vary]]
key = "plant.motor_noise_deg"
from = 0.0
to = 0.05
"""
HAZARDS = """title = "Short"
use = "A test"
experiment = "pressing"
head_radius_mm = 10.0
[[threshold]]
name = "hand"
force_N = 30.5
source = "made up"
[[hazard]]
id = "H1"
hazard = "One drive turns by itself"
harm = "Pain"
severity = "minor"
causes = [{ fault = "drive_runaway", target = "drive_2" }]
limit_N = 22.5
control = "Monitor"
residual = "Little"
[hazard.evidence]
bodies = ["back"]
reach_mm = 5.0
search = 3
draws = 2
"""
OSP = """<?xml version="1.0"?>
<OspSystemStructure xmlns="http://opensimulationplatform.com/MSMI/OSPSystemStructure" version="0.1">
<BaseStepSize>0.001</BaseStepSize><Simulators>
<Simulator name="a" source="TREE/fmus/velocity_servo/velocity_servo.fmu"><InitialValues>
<InitialValue variable="omega_ref"><Real value="1.5"/></InitialValue></InitialValues></Simulator>
<Simulator name="b" source="TREE/fmus/velocity_servo/velocity_servo.fmu"/></Simulators>
<Connections><VariableConnection><Variable simulator="a" name="omega_m"/>
<Variable simulator="b" name="omega_ref"/></VariableConnection></Connections></OspSystemStructure>
"""
MULTI_MODEL = """{"fmus": {"{x}": "TREE/fmus/velocity_servo/velocity_servo.fmu"},
"connections": {"{x}.a.omega_m": ["{x}.b.omega_ref"]}, "parameters": {"{x}.a.omega_ref": 1.5},
"algorithm": {"type": "fixed-step", "size": 0.001}, "endTime": 0.5}
"""
SSD = """<?xml version="1.0"?>
<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
 xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0" name="loop">
<ssd:System name="loop"><ssd:Elements>
<ssd:Component name="a" source="../TREE_FMUS/ideal_velocity.fmu"><ssd:Connectors>
<ssd:Connector name="omega_ref" kind="input"><ssc:Real/></ssd:Connector>
<ssd:Connector name="omega_m" kind="output"><ssc:Real/></ssd:Connector></ssd:Connectors></ssd:Component>
<ssd:Component name="b" source="resources/servo.fmu"><ssd:Connectors>
<ssd:Connector name="omega_ref" kind="input"><ssc:Real/></ssd:Connector>
<ssd:Connector name="omega_m" kind="output"><ssc:Real/></ssd:Connector></ssd:Connectors></ssd:Component>
</ssd:Elements><ssd:Connections>
<ssd:Connection startElement="a" startConnector="omega_m" endElement="b" endConnector="omega_ref"/>
<ssd:Connection startElement="b" startConnector="omega_m" endElement="a" endConnector="omega_ref">
<ssc:LinearTransformation factor="0.5" offset="1.0"/></ssd:Connection>
</ssd:Connections></ssd:System></ssd:SystemStructureDescription>
""".replace("../TREE_FMUS/ideal_velocity.fmu", "resources/ideal.fmu")
PACK = """import sys, zipfile
with zipfile.ZipFile("loop.ssp", "w") as archive:
    archive.write("SystemStructure.ssd")
    archive.write(sys.argv[1] + "/fmus/ideal_velocity/ideal_velocity.fmu", "resources/ideal.fmu")
    archive.write(sys.argv[1] + "/fmus/velocity_servo/velocity_servo.fmu", "resources/servo.fmu")
"""
SSV = """<?xml version="1.0"?>
<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="v">
<ssv:Parameters><ssv:Parameter name="T_m"><ssv:Real value="0.02"/></ssv:Parameter></ssv:Parameters>
</ssv:ParameterSet>
"""
SERVO = "TREE/fmus/velocity_servo/velocity_servo.fmu"
PARTS = """command = "velocity"
sign = 1
gear_ratio = 1.0
[parts.lag]
fmu = "TREE/fmus/velocity_servo/velocity_servo.fmu"
[parts.lag.parameters]
T_m = 0.001
droop = 0.0
[parts.servo]
fmu = "TREE/fmus/velocity_servo/velocity_servo.fmu"
[wires]
"servo.omega_ref" = "lag.omega_m"
[inputs]
command = "lag.omega_ref"
tau_load = "servo.tau_load"
[outputs]
theta_m = "servo.theta_m"
omega_m = "servo.omega_m"
tau_motor = "servo.tau_motor"
"""
SWEEP = """experiment = "mine.toml"
runs = 4
design = "latin_hypercube"
seed = 3
{more}
[[vary]]
key = "controller.force.kp_mm_per_N"
from = 2.0
to = 4.0
[[vary]]
key = "seed"
values = [1, 2, 3, 4]
"""
CHANGING = """extends = "pressing.toml"
[[fault]]
kind = "surface_jump"
target = "contact"
onset_s = 7.0
magnitude_mm = 10.0
[[change]]
t_s = 6.5
key = "controller.force.reference_N"
value = 4.0
[[measure]]
name = "force"
kind = "spread"
signal = "-plant.F_ee_B[2]"
begin_s = 5.0
until_s = 6.0
"""
VARIED = """experiment = "mine.toml"
record = "{record}"
[[vary]]
key = "controller.force.kp_mm_per_N"
values = [2.0, 3.0, 40.0]
"""
REQUIREMENT = "'always (|plant.F_ee_B| <= 18 N)'"

STUDIES: dict[str, tuple[str, ...]] = {
    "shadow run": (
        FOUR,
        f"shadow {FIG4} --source a --speed 0 --no-alarm --out s",
        f"shadow {FIG4} --source a --speed 0 --no-alarm --duration-s 3 --json --out t",
    ),
    "shadow alarm": (
        f"{FOUR} --set plant.k_s_Nm_per_rad=0.8",
        f"shadow {FIG4} --source a --speed 0 --out s",
    ),
    "shadow what-if": (
        FOUR,
        f"shadow {FIG4} --source a --speed 0 --no-alarm --duration-s 6.5 --force-limit-N 4 --out s "
        "--what-if controller.force.kp_mm_per_N=3 --what-if controller.force.reference_N=6",
    ),
    "shadow fleet": (
        FOUR,
        f"shadow {FIG4} --source a --speed 0 --set duration_s=7 --fleet fleet.toml --duration-s 3 --out s",
    ),
    "shadow log": (
        FOUR,
        LOG,
        "log new robot.csv",
        f"shadow {FIG4} --source robot.csv --map robot.map.toml --speed 0 --no-alarm --duration-s 4 --out s",
        "export a --ros2 --out bag",
        f"shadow {FIG4} --source bag --map bag/map.toml --speed 0 --no-alarm --duration-s 4 --out t",
        f"shadow {FIG4} --source nowhere.csv",
    ),
    "replay log": (
        FOUR,
        LOG,
        f"replay robot.csv --experiment {FIG4} --plant --out x",
        f"replay robot.csv --experiment {FIG4} --tolerance 0.2 --json --out y",
        "replay robot.csv",
    ),
    "replay spoiled": (
        FOUR,
        LOG,
        "python spoil.py",
        *(f"replay {name}.csv --experiment {FIG4} --plant --json --out {name}" for name in ("gap", "nan", "cut")),
        f"replay count_free.csv --experiment {FIG4} --out none",
        f"replay gap.csv --experiment {FIG4} --from-s 1 --to-s 2.5 --baseline 0:1 --out part",
    ),
    "replay bag": (
        FOUR,
        "export a --ros2 --out bag",
        f"replay bag --map bag/map.toml --experiment {FIG4} --plant --json --out x",
    ),
    "replay without its experiment": (
        "run mine.toml --isolate none --out a",
        "python forget.py",
        "replay a --out x",
    ),
    "identify log": (
        "run calibration_one_pose --isolate none --out a",
        LOG,
        "identify robot.csv --experiment calibration_one_pose --out found",
        "identify robot.csv --experiment calibration_one_pose --from-s 2 --json --out again",
    ),
    "branch": (
        "run pressing --set recording.state_every_s=4 --isolate none --out a",
        "branch a --at 6.2 --set plant.k_s_Nm_per_rad=0.8 --set 'controller.force.kp_mm_per_N=5;"
        "controller.force.reference_N=4' --body shoulder --isolate none --out b "
        '--fault \'{kind = "drive_dead", target = "drive_2", onset_s = 6.5}\'',
        "branch a --at 6.2 --set seed=3 --out refused",
    ),
    "branch without states": (
        "run pressing --isolate none --out a",
        "branch a --at 3 --body back --set plant.k_s_Nm_per_rad=0.8 --json --isolate none --out b",
    ),
    "going on": (
        f"run {FIG4} --set {FIG4_SHORT} --set recording.state_every_s=3 --isolate none --out a",
        "run --from a@4 --isolate none --out b",
        "run --from a --isolate none --out c",
        "run --from a@99 --isolate none --out d",
    ),
    "safety": ("safety short.toml --quick --isolate none --out s", "safety short.toml --json --isolate none --out t"),
    "falsify places": (
        f"falsify pressing --requirement {REQUIREMENT} --kind drive_runaway --runs 12 --reach-mm 5 -j 2 --json --out f",
    ),
    "falsify together": (
        f"falsify pressing --requirement {REQUIREMENT} --set-of common --body back --runs 8 -j 1 --out f",
    ),
    "faults singles": ("faults pressing --set-of single --isolate none --out f",),
    "faults common": (
        "faults pressing --set-of common --kind drive_runaway --body back --isolate none --json --out f",
    ),
    "faults pairs": (
        "faults pressing --set-of pairs --kind drive_runaway --kind sample_loss --body back --isolate none --out f",
    ),
    "cosim FMU": (
        f"cosim {SERVO} --stop-s 1 --set T_m=0.02 --input 'omega_ref=2*step(0.5)' --record '*' --isolate none --out a",
        f"cosim {SERVO} --stop-s 1 --ssv values.ssv --input in.csv --isolate none --json --out b",
        f"cosim {SERVO} --set T_m=0.02 --to ssp --out servo.ssp",
        f"cosim {SERVO} --stop-s 1 --state-every-s 0.4 --set omega_ref=1 --isolate none --out c",
        f"cosim {SERVO} --stop-s 1 --state-every-s 0.4 --set omega_ref=1 --from c@0.5 --isolate none --out d",
    ),
    "cosim model exchange": tuple(
        f"cosim TREE/fmus/modelica_dc/modelica_dc.fmu --kind model_exchange --solver {solver} --stop-s 0.2 "
        f"--tick-ms 1 --isolate none --out {solver}"
        for solver in ("rk4", "cvode")
    ),
    "cosim system": (
        "cosim OspSystemStructure.xml --stop-s 0.5 --isolate none --out osp",
        "cosim mm.json --isolate none --json --out multi",
        "python pack.py TREE",
        "cosim loop.ssp --stop-s 0.5 --tick-ms 1 --isolate none --out delay",
        "cosim loop.ssp --stop-s 0.5 --tick-ms 1 --loops solve --scheme jacobi --step b=2 --isolate none --out solve",
        f"cosim {SERVO} TREE/fmus/ideal_velocity/ideal_velocity.fmu --stop-s 0.2 --isolate none --out joined",
    ),
    "drive of parts": (
        f"cosim {SERVO} --set T_m=0.02 --to ssp --out servo.ssp",
        f"run {FIG4} --set {FIG4_SHORT} --drive servo.ssp --isolate none --out a",
        f"run {FIG4} --set {FIG4_SHORT} --drive parts.toml --isolate none --out b",
    ),
    "sweep of faults": ("sweep sweep.toml -j 1 --out rows --yes", "sweep show rows --json"),
    "sweep records failures": ("sweep sweep.toml -j 1 --out rows --yes",),
    "own measures": (
        "check mine.toml --isolate none -j 1",
        "check mine.toml --update first --yes",
        "run mine.toml --isolate none --json --out a",
    ),
    "drive that fails": (
        "drive compare velocity_servo modelica_dc --experiment mine.toml --isolate none --json",
        "drive compare velocity_servo nothing --experiment mine.toml",
    ),
    "component check": (
        "component check controller TREE/fmus/parts/paper_law --set duration_s=1 --isolate none",
        "component check controller examples/my_controller.py:Controller --set duration_s=1 --isolate none --json",
    ),
}
"""Lines that belong together, by what they are about."""

BESIDE = {
    "shadow fleet": {"fleet.toml": FLEET},
    "replay spoiled": {"spoil.py": SPOILED},
    "replay without its experiment": {
        "mine.toml": f'extends = "{FIG4}.toml"\nduration_s = 7\n',
        "forget.py": "import os\nos.remove('mine.toml')\n",
    },
    "safety": {"short.toml": HAZARDS},
    "cosim FMU": {"values.ssv": SSV, "in.csv": "t_s,omega_ref\n0.0,0.0\n0.5,1.0\n1.0,-1.0\n"},
    "cosim system": {
        "OspSystemStructure.xml": OSP, "mm.json": MULTI_MODEL, "SystemStructure.ssd": SSD, "pack.py": PACK
    },
    "drive of parts": {"parts.toml": PARTS},
    "sweep of faults": {"sweep.toml": SWEEP.format(more=""), "mine.toml": CHANGING},
    "sweep records failures": {"sweep.toml": VARIED.format(record="failures"), "mine.toml": CHANGING},
    "own measures": {"mine.toml": CHANGING},
    "drive that fails": {"mine.toml": f'extends = "{FIG4}.toml"\nduration_s = 6.5\n'},
}  # fmt: skip
"""Files of those that need some."""

LOOK = {"panels": ["Pressing force F_z", "Height z"], "width": 400, "list": True}
FIRST = {"set": {"controller.force.kp_mm_per_N": 3.0}}
BROKEN = {"faults": [{"kind": "surface_jump", "target": "contact", "onset_s": 6.0, "magnitude": 10.0}]}
EXPLORED: dict[str, tuple[str, tuple[dict, ...]]] = {
    "explore states": (
        f"{FIG4} --set duration_s=8",
        (
            {"op": "describe", "state": {}},
            {"op": "describe", "state": {"drive": "pmsm_foc", "body": "back"}},
            {"op": "show", "state": {}, **LOOK},
            {"op": "show", "state": FIRST, **LOOK, "robot": True, "span": [5.0, 6.0]},
            {"op": "show", "state": BROKEN, **LOOK},
            {"op": "show", "state": {"set": {"nothing": 1}}, **LOOK},
            {"op": "onset", "state": {}},
            {"op": "save", "state": FIRST, "name": "mine"},
            {"op": "command", "state": BROKEN},
            {"op": "nothing"},
        ),
    ),
    "explore scores": (
        FIG4,
        (
            {"op": "show", "state": FIRST, **LOOK, "layout": "fig4"},
            {"op": "loops", "state": FIRST, "point": 0},
            {"op": "score", "state": FIRST},
        ),
    ),
    "explore records": (
        "pressing",
        ({"op": "runs"}, {"op": "recorded", "run": "results/a", **LOOK}, {"op": "columns", "log": "robot.csv"},
         {"op": "log", "log": "robot.csv", **LOOK}),
    ),
}  # fmt: skip
"""Command lines of `explore` without their first word, and what a page asks them, by what they are about."""
BEFORE_A_PAGE = {
    "explore records": (FOUR.replace("--out a", "--out results/a"), LOG.replace("export a", "export results/a"))
}


def study_cases() -> list[Case]:
    """The cases of studies, and of the explorer."""
    asked = [
        Case(name, commands=BEFORE_A_PAGE.get(name, ()), page=(line, asks)) for name, (line, asks) in EXPLORED.items()
    ]
    return [*(Case(name, files=BESIDE.get(name, {}), commands=lines) for name, lines in STUDIES.items()), *asked]
