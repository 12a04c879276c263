"""The compiled code that is kept between processes, see `twin.compiled`."""

import os
from pathlib import Path

from twin.cache_folder import files_below
from twin.compiled.cache import use_cache


def compiled_folder() -> Path:
    """Where what was compiled of this source is kept."""
    return Path(os.environ.get("NUMBA_CACHE_DIR") or use_cache())


def compiled_pieces() -> int:
    """How many pieces of machine code are kept; what a run needs beyond them is compiled when it is needed."""
    return sum(file.name.endswith((".o", ".nbc")) for file in files_below(compiled_folder()))
