"""`twin schema`: the experiment file for editors."""

from pathlib import Path
from typing import Annotated

import typer

from twin.cli import early
from twin.writing import write_text


def schema(
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write it there instead of printing it.")] = None,
) -> None:
    """Print the JSON Schema of the experiment file, for editors.

    An editor that knows TOML schemas (Even Better TOML, taplo) completes and
    checks a file that begins with the line `#:schema experiment.schema.json`.

    Exit code: 0 done, 3 it cannot be written.

    Example: twin schema --out experiment.schema.json
    """
    if out is None:
        early.print_schema()
        return
    write_text(out, early.schema())
    print(out)
