"""The compiled code that is kept between processes, see `twin.native_cache`."""

import os
from pathlib import Path


def compiled_folder() -> Path:
    """Where numba keeps what it has compiled of this source."""
    return Path(os.environ["NUMBA_CACHE_DIR"])


def is_warm() -> bool:
    """Whether anything has been compiled before. What a run needs beyond it is still compiled when it is needed."""
    return next(compiled_folder().rglob("*.nbi"), None) is not None
