"""The compiled code that is kept between processes, see `twin.compiled.cache`."""

import os
from pathlib import Path

from twin.compiled.cache import use_cache


def compiled_folder() -> Path:
    """Where numba keeps what it has compiled of this source."""
    use_cache()
    return Path(os.environ["NUMBA_CACHE_DIR"])


def compiled_pieces() -> int:
    """How many pieces of machine code are kept: of each compiled function one for every kind of arguments.

    What a run needs beyond them is compiled when it is needed.
    """
    return sum(1 for _ in compiled_folder().rglob("*.nbc"))
