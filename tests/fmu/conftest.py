"""Makes the FMU builder importable under the name that fmus/build.py uses."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "fmus"))
