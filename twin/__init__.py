"""Co-simulation digital twin of a 3-DOF delta-like massage robot with series elastic joints."""

__version__ = "0.1.0"

from twin.native_cache import use_cache

use_cache()
