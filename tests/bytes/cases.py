"""The cases: what is done in both trees.

The list follows from the files of the tree before the change: what is new has nothing to be compared with.
"""

import re
from pathlib import Path

from tests.bytes.case import FIG4, FIG4_SHORT, Case
from tests.bytes.study_cases import study_cases

SHORTER = {
    "calibration": 30.0,
    "calibration_one_pose": 30.0,
    "fig4_force_position": 8.0,
    "fig4_imperfect": 8.0,
    "fig4_imperfect_position": 8.0,
    "fig4_position": 8.0,
}
"""Seconds that say enough of an experiment with a drive that is not its own; all others are run whole."""
LONGEST = {"calibration": 60.0}
"""The same with its own drive."""


def all_cases(tree: Path) -> list[Case]:
    """Those of the tree at `tree`; what takes longest first."""
    runs = (*_each_drive(tree), *_each_body(tree), *_faults(tree), *_couplings(), *_variants(), *_forms())
    return [*study_cases(), *_commands(), *runs]


def _each_drive(tree: Path) -> list[Case]:
    """Each experiment with its own drive and with each of fmus/."""
    experiments = sorted(path.stem for path in (tree / "experiments").glob("*.toml"))
    drives = sorted(path.parent.name for path in (tree / "fmus").glob("*/*.fmu"))
    cases = []
    for experiment in experiments:
        own = _lasting(LONGEST.get(experiment))
        cases.append(Case(f"run {experiment}", quick=True, load=(experiment, own, None, None)))
        for drive in drives:
            shorter = _lasting(SHORTER.get(experiment))
            quick = experiment == FIG4
            cases.append(Case(f"run {experiment} {drive}", quick, load=(experiment, shorter, drive, None)))
    return cases


def _lasting(seconds: float | None) -> tuple[str, ...]:
    return () if seconds is None else (f"duration_s={seconds}",)


def _each_body(tree: Path) -> list[Case]:
    return [
        Case(f"body {path.stem}", quick=True, load=("pressing", (), None, path.stem))
        for path in sorted((tree / "experiments" / "bodies").glob("*.toml"))
    ]


FAULT = re.compile(r"^\| `(\w+)` \| [^|]* \| `(\w+)`[^|]* \| (?:`(\w+)`|none) \| ([^|]*) \|", re.MULTILINE)
"""A row of the catalogue: kind, first target, key of the magnitude, three magnitudes."""


def _faults(tree: Path) -> list[Case]:
    """Each kind of fault with a medium magnitude while a task is pressed, with the monitor on and once without."""
    cases = []
    for kind, target, key, sizes in FAULT.findall((tree / "docs" / "faults_reference.md").read_text("utf-8")):
        magnitude = f"{key} = {sizes.split(',')[1].strip()}\n" if key else ""
        more = "share = 0.01\n" if kind == "encoder_glitch" else ""
        table = f'[[fault]]\nkind = "{kind}"\ntarget = "{target}"\nonset_s = 6.0\nduration_s = 2.0\n{magnitude}{more}'
        text = f'extends = "pressing.toml"\n{table}'
        cases.append(Case(f"fault {kind}", True, {"broken.toml": text}, ("broken.toml", (), None, None)))
        unwatched = ("monitor.enabled=false",)
        cases.append(
            Case(f"fault {kind} unwatched", False, {"broken.toml": text}, ("broken.toml", unwatched, None, None))
        )
    return cases


def _couplings() -> list[Case]:
    """Each scheme, kind of input and number of iterations, with a drive of each FMI version."""
    return [
        Case(
            f"coupling {scheme} {inputs} {iterations} {drive}",
            drive == "pmsm_foc",
            load=(
                FIG4,
                (
                    FIG4_SHORT,
                    f"cosim.scheme={scheme}",
                    f"cosim.inputs={inputs}",
                    f"cosim.iterations={iterations}",
                ),
                drive,
                None,
            ),
        )
        for scheme in ("gauss_seidel", "jacobi")
        for inputs in ("hold", "linear")
        for iterations in (1, 2)
        for drive in ("pmsm_foc", "torque_motor_fmi3")
    ]


VARIANTS = {
    # the file that is extended, and what is laid over it
    "changes": (
        FIG4,
        'duration_s = 12.0\n[[change]]\nt_s = 7.0\nkey = "controller.force.reference_N"\nvalue = 4.0\n'
        '[[change]]\nt_s = 8.0\nkey = "controller.force.kp_mm_per_N"\nvalue = 1.5\n'
        '[[change]]\nt_s = 9.0\nkey = "controller.force.ki_mm_per_N_s"\nvalue = 0.8\n'
        '[[change]]\nt_s = 10.0\nkey = "controller.position.kp_per_s"\nvalue = 2.0\n',
    ),
    "rate": (FIG4, 'duration_s = 8.0\n[recording]\nrate = "controller"\n'),
    "monitor": (FIG4, "duration_s = 8.0\n[monitor]\n"),
    "trip": (FIG4, "duration_s = 8.0\n[monitor]\nforce_limit_N = 3.0\n"),
    "late": (FIG4, "duration_s = 8.0\n[controller]\ndelay_ticks = 2\nbus_delay_ticks = 3\n"),
    "imperfections": (
        FIG4,
        "duration_s = 8.0\nseed = 7\n[robot]\nmotor_noise_deg = 0.05\njoint_noise_deg = 0.02\n"
        "motor_eccentricity_deg = [0.1, 0.2, 0.3]\nmotor_eccentric_at_deg = [10.0, 20.0, 30.0]\n"
        "joint_eccentricity_deg = [0.05, 0.02, 0.01]\nencoder_latency_ms = 2.0\nbelt_compliance_rad_per_Nm = 0.02\n"
        "joint_friction_Nm = 0.004\nspring_hysteresis = 0.05\nspring_stop_deg = 15.0\njoint_lower_deg = -60.0\n"
        "joint_upper_deg = 80.0\nmounting_tilt_deg = 3.0\nmounting_tilt_x_deg = -2.0\nhead_mm = [1.0, 2.0, -3.0]\n"
        "eta_rate_rad_per_s = 0.1\n[plant]\neta = 0.9\nk_s_Nm_per_rad = 1.1\n",
    ),
    "kelvin_voigt": (
        FIG4,
        'duration_s = 8.0\n[contact]\nbody = "belly"\nshape = "sphere"\nradius_mm = 60.0\n',
    ),
    "exponential": (
        FIG4,
        'duration_s = 8.0\n[contact]\nlaw = "exponential"\nstiffening_per_mm = 0.1\nshape = "cylinder_x"\n'
        "radius_mm = 60.0\ntilt_deg = 5.0\ntilt_x_deg = 3.0\n",
    ),
    "power": (
        FIG4,
        "duration_s = 8.0\n[contact]\nexponent = 1.5\nreference_depth_mm = 4.0\n"
        'shape = "cylinder_y"\nradius_mm = 60.0\n',
    ),
    "breathing and shift": (
        "pressing",
        "[contact.breathing]\namplitude_mm = 1.0\nrate_per_min = 20.0\nend_s = 9.0\n"
        "[contact.shift]\nby_mm = [1.0, 0.0, 2.0]\nstart_s = 5.0\nrise_s = 0.5\nend_s = 7.0\n",
    ),
    "energy tank": ("pressing", "[controller.energy_tank]\nsize_J = 0.02\nrelease_s = 1.0\n"),
    "own Python": (FIG4, 'duration_s = 8.0\n[controller]\npython = "examples/my_controller.py:Controller"\n'),
    "own FMU": (FIG4, 'duration_s = 8.0\n[controller]\nfmu = "fmus/parts/paper_law"\n'),
    "three drives": (
        FIG4,
        'duration_s = 8.0\n[drive.joint_1]\nfmu = "fmus/pmsm_foc"\n[drive.joint_2]\nfmu = "fmus/mx106"\n',
    ),
    "substeps": (FIG4, "duration_s = 8.0\n[drive]\nsubsteps = 4\n[plant]\nsubsteps = 3\n"),
}
"""What no shipped experiment has."""


def _variants() -> list[Case]:
    return [
        Case(
            f"variant {name}",
            True,
            {"variant.toml": f'extends = "{under}.toml"\n{text}'},
            ("variant.toml", (), None, None),
        )
        for name, (under, text) in VARIANTS.items()
    ]


def _forms() -> list[Case]:
    """Each form of machine code that this processor can run, where there are several."""
    cpu = Path("/proc/cpuinfo")
    flags = set(cpu.read_text("utf-8").split()) if cpu.exists() else set()
    # runs in processes of their own, as a process has one form
    lines = (f"run {FIG4} --set {FIG4_SHORT} --out a", "run pressing --body back --out b")
    return [
        Case(f"form {name}", True, commands=lines, environment={"TWIN_PROCESSOR": name})
        for name, needed in (("any", {"sse2"}), ("avx", {"avx"}), ("avx512", {"avx512f", "avx512vl"}))
        if needed <= flags
    ]


ALL_HELP = (
    "run", "compare", "check", "faults", "falsify", "runs", "report", "replay", "converge", "accuracy", "identify",
    "export", "build", "cosim", "analyse", "tune", "init", "schema", "doctor", "sweep", "sweep run", "sweep show",
    "drive", "drive survey", "drive info", "drive list", "drive new", "drive check", "drive compare", "component",
    "component list", "component check", "log", "log new", "branch", "safety", "shadow", "explore",
)  # fmt: skip

SHORT_RUN = f"run {FIG4} --set {FIG4_SHORT} --isolate none --out a"
OTHER_RUN = f"run fig4_position --set {FIG4_SHORT} --isolate none --out b"
SWEEP = """experiment = "step_z_air.toml"
[[vary]]
key = "controller.position.kp_per_s"
values = [1.0, 1.5, 2.0]
"""
REQUIREMENT = "'always (|plant.F_ee_B| <= 18 N)'"

SLOW: dict[str, tuple[str, ...]] = {
    "build": (
        f"build {FIG4} --fmu plant --isolate none --out plant.fmu",
        f"build {FIG4} --fmu computer --fmi 3 --isolate none --out computer.fmu --json",
    ),
    "build c": ("build pressing --c --isolate none --out c",),
    "build ssp": (
        f"build {FIG4} --ssp --isolate none --out robot.ssp",
        "cosim robot.ssp --stop-s 2 --isolate none --out gauss",
        "cosim robot.ssp --stop-s 2 --scheme jacobi --out jacobi --json",
        "export gauss --csv --rate 10 --out table.csv",
        "drive new robot.ssp",
    ),
    "tune": ("tune step_z_air --isolate none", "tune step_z_air --isolate none --json --out again"),
    "falsify": (f"falsify pressing --requirement {REQUIREMENT} --kind surface_jump --runs 4 -j 1 --json",),
    "paper": (
        "run fig4_force_position fig4_position fig4_imperfect fig4_imperfect_position --isolate none",
        "compare --paper fig4",
        "compare --paper fig4 --json",
        "report results/fig4_force_position results/fig4_position --out page.html --isolate none",
    ),
    "paper tasks": (
        "run pressing tapping rolling pushing --isolate none --json",
        "compare --paper fig5",
        "report results/tapping --isolate none --budget",
    ),
    "converge": ("converge step_z_air --duration 0.8 --isolate none", "converge step_z_air --duration 0.8 --json"),
    "accuracy": (
        f"accuracy {FIG4} --set {FIG4_SHORT} --isolate none",
        f"accuracy {FIG4} --set {FIG4_SHORT} --isolate none --json",
    ),
    "identify": (
        "run calibration_one_pose --isolate none --out a",
        "identify a --out found",
        "identify a --json --out again",
    ),
    "analyse": (
        f"analyse {FIG4} --no-try --isolate none",
        f"analyse {FIG4} --no-try --isolate none --json",
        "analyse step_z_air --passivity --isolate none",
    ),
    "faults": (
        "faults pressing --kind surface_jump --onset 6 --isolate none",
        "faults pressing --kind surface_jump --onset 6 --json",
    ),
    "drive check": (
        "drive check velocity_servo --isolate none",
        "drive check torque_motor_fmi3 --isolate none --json",
        "drive check modelica_dc stepper --table",
    ),
    "drive compare": ("drive compare velocity_servo pmsm_foc --experiment pressing --isolate none --html",),
    "drive survey": ("drive survey TREE/fmus/stepper", "drive survey TREE/fmus/velocity_servo --json"),
    "sweep": (
        "sweep sweep.toml -j 1 --out rows --yes",
        "sweep show rows --html",
        "sweep run sweep.toml --out rows --json",
        "run step_z_air --sweep controller.position.kp_per_s=1:2:2 --yes",
    ),
    "run tasks": ("run pressing --body back --json --report --out a",),
    "run isolated": (f"run {FIG4} --set {FIG4_SHORT} --isolate drive --out a",),
}
"""Lines that belong together, by what they are about."""

FAST: dict[str, tuple[str, ...]] = {
    "run": (SHORT_RUN, f"run {FIG4} --set {FIG4_SHORT} --json --out b --isolate none"),
    "run refused": (
        "run fig4_force_positon",
        f"run {FIG4} --set controller.force.kp=3",
        f"run {FIG4} --set controller.force.kp_mm_per_N=-3",
        f"run {FIG4} --drive pmsm_fok",
        f"run {FIG4} --body bak",
        f"run {FIG4} --isolat none",
        "run",
    ),
    "run tripped": ("run pressing --set monitor.speed_limit_mm_per_s=20 --isolate none --out a",),
    "run broken": ("run broken.toml --isolate none --out a", "run broken.toml --isolate none --json --out b"),
    "compare": (
        SHORT_RUN,
        OTHER_RUN,
        "compare a b",
        "compare a b --json --signal plant.p_B --tol 0.1mm@10ms",
        "compare a nowhere",
        "compare a",
    ),
    "check": (
        "check step_z_air --drive velocity_servo --isolate none",
        "check step_z_air --drive own --json -j 1",
        "check step_z_ar",
    ),
    "faults refused": ("faults pressing --kind surface_jumps", "faults nowhere"),
    "falsify refused": ("falsify pressing --requirement 'always('", "falsify nowhere"),
    "runs": (SHORT_RUN.replace("--out a", ""), "runs", "runs --json", "runs nowhere"),
    "report": (
        SHORT_RUN,
        OTHER_RUN,
        "report a --isolate none",
        "report a b --isolate none --out both.html --json",
        "report nowhere",
    ),
    "replay": (SHORT_RUN, "replay a --plant --out x", "replay a --json --out y", "replay nowhere"),
    "converge refused": ("converge pressing", "converge nowhere"),
    "accuracy refused": ("accuracy step_z_air", "accuracy nowhere"),
    "identify refused": ("run step_z_air --isolate none --out a", "identify a", "identify nowhere"),
    "export": (
        SHORT_RUN,
        "export a --csv --signals plant.p_B --rate 100",
        "export a --mat",
        "export a --ros2 --signals 'plant.*'",
        "export a --parquet --rate 100",
        "export a --csv --signals plant.q_B",
        "export nowhere --csv",
    ),
    "build refused": (f"build {FIG4} --fmu plent", f"build {FIG4}", "build nowhere --c"),
    "cosim refused": ("cosim nowhere.ssp",),
    "analyse refused": ("analyse nowhere",),
    "tune refused": ("tune step_z_air --margin 0.5", "tune nowhere"),
    "init": (
        "init",
        "init mine.toml --from pressing",
        "init mine.toml",
        "init --from nothing",
        "run mine.toml --isolate none --out a",
    ),
    "schema": ("schema", "schema --out s.json", "schema --out nowhere/s.json"),
    "doctor": ("doctor", "doctor --json", "doctor --jason"),
    "sweep refused": ("sweep nowhere", "sweep show nowhere", "sweep sweep.toml --by nothing --dry-run --yes -j 1"),
    "drive info": (
        "drive info velocity_servo",
        "drive info pmsm_foc --json",
        "drive info xl330",
        "drive info torque_motor_fmi3",
        "drive info nothing",
    ),
    "drive list": ("drive list", "drive list --json", "drive list all"),
    # a good one, which writes beside the FMU, is in "build ssp"
    "drive new": ("drive new nothing.fmu", "drive new"),
    "drive refused": ("drive check nothing", "drive compare velocity_servo", "drive survey nowhere", "drive infos"),
    "component": ("component list", "component list --json", "component check controler", "component check"),
    "log": (SHORT_RUN, "export a --csv --rate 100 --out robot.csv", "log new robot.csv", "log new nowhere.csv"),
    "no command": ("", "rn", "--versions", "--version"),
}

BESIDE = {
    "sweep": {"sweep.toml": SWEEP},
    "sweep refused": {"sweep.toml": SWEEP},
    "run broken": {
        "broken.toml": 'extends = "pressing.toml"\n[[fault]]\nkind = "drive_failure"\n'
        'target = "drive_2"\nonset_s = 6.0\n'
    },
}
"""Files of those that need some."""


def _commands() -> list[Case]:
    """One command line and more of each command, and the help of each."""
    helped = tuple(f"{words} --help".strip() for words in ("", *ALL_HELP))
    return [
        *(Case(f"command {name}", False, BESIDE.get(name, {}), None, lines) for name, lines in SLOW.items()),
        Case("command help", True, commands=helped),
        *(Case(f"command {name}", True, BESIDE.get(name, {}), None, lines) for name, lines in FAST.items()),
    ]
