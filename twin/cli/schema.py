"""`twin schema`: the experiment file for editors."""

from pathlib import Path
from typing import Annotated

import typer

from twin.errors import InputRefused


def schema(
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write it there instead of printing it.")] = None,
) -> None:
    """Print the JSON Schema of the experiment file, for editors.

    An editor that knows TOML schemas (Even Better TOML, taplo) completes and
    checks a file that begins with the line `#:schema experiment.schema.json`.

    Exit code: 0 done, 2 it cannot be written.

    Example: twin schema --out experiment.schema.json
    """
    from twin.experiment.json_schema import schema_text

    text = schema_text()
    if out is None:
        print(text, end="")
        return
    try:
        out.write_text(text)
    except OSError as problem:
        raise InputRefused(f"{out}: cannot be written: {problem.strerror}") from None
    print(out)
