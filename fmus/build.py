"""Build the drive FMUs: `python fmus/build.py [drive ...]`. Needs `pip install .[fmus]` for the compiler."""

import argparse

from builder.archive import write_fmu
from builder.compile import TARGETS
from builder.drive import FMUS, drive_names, load_drive


def main() -> None:
    """Build the drives named on the command line, or all, each into its own folder."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("drive", nargs="*", help=f"which drives (default: all of {', '.join(drive_names())})")
    names = parser.parse_args().drive or drive_names()
    for unknown in sorted(set(names) - set(drive_names())):
        parser.error(f"there is no drive '{unknown}'; there are: {', '.join(drive_names())}")
    for name in names:
        target = FMUS / name / f"{name}.fmu"
        write_fmu(load_drive(name), TARGETS, FMUS / ".build" / name, target)
        print(target.relative_to(FMUS.parent))


if __name__ == "__main__":
    main()
