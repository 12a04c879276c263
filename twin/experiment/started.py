"""A new experiment file and its schema, written."""

from pathlib import Path

from twin.errors import InputRefused
from twin.experiment.json_schema import SCHEMA_FILE, schema_text
from twin.experiment.named import did_you_mean, known_experiments
from twin.experiment.template import commented_experiment


def start_experiment(file: Path, start: str) -> list[Path]:
    """Write an experiment to `file` that does what the experiment `start` of those that come with twin does.

    Returns:
        The files that were written: `file`, and beside it the JSON Schema if none was there.

    Raises:
        InputRefused: `file` exists or cannot be written, or there is no experiment `start`.
    """
    known = known_experiments()
    if start not in known:
        raise InputRefused(f"--from {start}: no such experiment; {did_you_mean(start)}")
    if file.suffix != ".toml":
        raise InputRefused(f"{file}: expected a name that ends with .toml")
    schema = file.parent / SCHEMA_FILE
    text = commented_experiment(file.name, known[start])
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("x") as empty:
            empty.write(text)
        if schema.exists():
            return [file]
        schema.write_text(schema_text())
    except FileExistsError:
        raise InputRefused(f"{file}: exists, and is never overwritten; choose another name") from None
    except OSError as problem:
        raise InputRefused(f"{problem.filename}: cannot be written: {problem.strerror}") from None
    return [file, schema]
