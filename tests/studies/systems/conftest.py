"""Systems as the tests of the kernel make them."""

from tests.kernel.systems.conftest import ideal, ran

__all__ = ["ideal", "ran"]
