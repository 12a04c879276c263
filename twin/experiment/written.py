"""A source as the text of one TOML file that says the same without other files."""

import json
from typing import Any

from twin.experiment.source import Source


def source_text(source: Source) -> str:
    """TOML in which every value stands with its origin: read again, it gives equal values and equal origins."""
    lines = (f"{json.dumps(key)} = {_toml(value, key, source.origins)}" for key, value in source.values.items())
    return "\n".join(lines) + "\n"


def _toml(value: Any, path: str, origins: dict[str, str]) -> str:
    """`value` at the dotted `path`; tables are written inline."""
    if isinstance(value, dict):
        return _table({key: _toml(item, f"{path}.{key}", origins) for key, item in value.items()})
    if isinstance(value, tuple) and value and all(isinstance(item, dict) for item in value):
        tables = (_toml(item, f"{path}.{number}", origins) for number, item in enumerate(value, start=1))
        return f"[{', '.join(tables)}]"
    plain = _plain(value)
    return _table({"value": plain, "source": _plain(origins[path])}) if path in origins else plain


def _table(texts: dict[str, str]) -> str:
    return "{" + ", ".join(f"{json.dumps(key)} = {text}" for key, text in texts.items()) + "}"


def _plain(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_plain, value))}]"
    # JSON writes numbers and truth values as TOML does, and texts but for DEL, which TOML wants escaped
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
