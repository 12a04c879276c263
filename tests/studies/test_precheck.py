"""A slip in a path is told before anything heavy is loaded, and leaves nothing behind."""

import os
import subprocess
import sys
from pathlib import Path

COMMANDS = """
analyse nosuch.toml
tune nosuch.toml
tune {fig4} --drive velocity_servo --drive nosuch.fmu
falsify nosuch.toml
converge nosuch.toml
accuracy nosuch.toml
faults {fig4} --body nosuch
identify nosuch.mcap
identify there.csv --experiment nosuch.toml
replay nosuch.csv
compare nosuch.mcap nosuch.csv
compare --paper fig4 nosuch nosuch
check nosuch.toml
build nosuch.toml --fmu plant
component check controller --experiment nosuch.toml
drive check velocity_servo nosuch
sweep nosuch.toml
sweep show nosuch
drive compare velocity_servo nosuch --experiment {fig4}
drive compare velocity_servo stepper --experiment nosuch.toml
"""

PROGRAM = """
import shlex, sys
from twin.cli.line import main
for line in sys.argv[1].strip().splitlines():
    sys.argv = ["twin", *shlex.split(line)]
    try:
        main()
    except SystemExit as end:
        print(end.code, line, sorted({"scipy", "matplotlib", "control", "numba"} & set(sys.modules)), flush=True)
"""


def test_no_command_loads_its_study_for_a_path_that_leads_nowhere(root: Path, tmp_path: Path):
    lines = COMMANDS.format(fig4=root / "experiments/fig4_force_position.toml")
    (tmp_path / "there.csv").write_text("t_s\n0.0\n")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, lines],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
    )
    assert done.stdout.splitlines() == [f"2 {line} []" for line in lines.strip().splitlines()]
    assert all("nosuch" in sentence for sentence in done.stderr.splitlines())
    assert [path.name for path in tmp_path.iterdir()] == ["there.csv"]
