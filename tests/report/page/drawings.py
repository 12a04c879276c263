"""Pictures that say which process has drawn them."""

import os
from pathlib import Path


def sign(shown: object, path: Path) -> None:
    path.write_text(f"{shown} {os.getpid()}")


def sign_at_home(home: int, path: Path) -> None:
    """Elsewhere than in the process `home` nothing can be drawn."""
    if os.getpid() != home:
        raise RuntimeError("not here")
    sign("at home", path)


def die_abroad(home: int, path: Path) -> None:
    if os.getpid() != home:
        os._exit(1)
    sign("at home", path)
