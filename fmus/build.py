"""Build drives and other parts: `python fmus/build.py [name ...]`. Needs `pip install .[fmus]` for the tools.

`--references` only writes the reference files into FMUs that are there, and needs none of the tools.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path
from subprocess import CalledProcessError

from builder.archive import write_fmu
from builder.compile import TARGETS, TARGETS_FMI3
from builder.drive import FMUS, drive_names, folder_of, load_drive, part_names
from builder.modelica import modelica_drive_names, pack_modelica_drive
from builder.python_slave import pack_python_drive, python_drive_names
from builder.references import carry_references, stated_references


def main() -> None:
    """Build the drives named on the command line, or all, each into its own folder."""
    tools = _tools()
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("drive", nargs="*", help=f"which drives (default: all of {', '.join(sorted(tools))})")
    parser.add_argument("--references", action="store_true", help="only write the reference files anew")
    asked = parser.parse_args()
    names = asked.drive or sorted(set(tools) - set(part_names() if asked.references else ()))
    for unknown in sorted(set(names) - set(tools)):
        parser.error(f"there is no drive '{unknown}'; there are: {', '.join(sorted(tools))}")
    for name in () if asked.references else names:
        missing = [tool for tool in tools[name] if find_spec(tool) is None]
        if missing:
            parser.error(f"drive '{name}' is made with {' and '.join(missing)}: pip install .[fmus]")
    for name in names:
        target = folder_of(name) / f"{name}.fmu"
        try:
            if not asked.references:
                build(name, FMUS / ".build" / name, target)
            if name in stated_references():
                carry_references(name, target)
        except CalledProcessError:
            # the compiler has said where and why
            parser.exit(1, f"drive '{name}' was not built\n")
        print(target.relative_to(FMUS.parent))


def _tools() -> dict[str, tuple[str, ...]]:
    """The packages each drive is made with, by its name."""
    compiled = dict.fromkeys([*drive_names("2.0"), *drive_names("3.0"), *part_names()], ("ziglang",))
    in_python = dict.fromkeys(python_drive_names(), ("pythonfmu",))
    in_modelica = dict.fromkeys(modelica_drive_names(), ("rumoca", "ziglang"))
    return compiled | in_python | in_modelica


def build(name: str, scratch: Path, target: Path) -> None:
    """Build drive `name` under `scratch` into the file `target`, whatever it is made of, without reference files."""
    if name in python_drive_names():
        pack_python_drive(name, scratch, target)
    elif name in modelica_drive_names():
        pack_modelica_drive(name, scratch, target)
    else:
        drive = load_drive(name)
        write_fmu(drive, {"2.0": TARGETS, "3.0": TARGETS_FMI3}[drive.fmi], scratch, target)


if __name__ == "__main__":
    main()
