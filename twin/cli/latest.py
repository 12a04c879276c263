"""Which run is meant by results/EXPERIMENT, told to whoever did not name one."""

import shlex
import sys
from collections.abc import Iterable
from pathlib import Path

from twin.errors import InputRefused, plain


def tell_latest(paths: Iterable[Path]) -> None:
    """Say on standard error which run each of `paths` means, and with which options it was made.

    Nothing is said of a file or of a run's own folder, nor of what is no folder of runs: whoever reads it refuses it.
    """
    from twin.recording.folder import recording_in

    for path in paths:
        try:
            recording = recording_in(path)
        except InputRefused:
            continue
        if path.is_dir() and recording.parent != path:
            # takes half a second to load
            from twin.studies.results.kept import kept_run

            run = kept_run(recording)
            made = f", made with {shlex.join(run.typed)}" if run.typed else ""
            print(plain(f"{path}: the latest run, {run.folder.name}{made}"), file=sys.stderr)
