"""What a process remembers of the installation, forgotten: what is asked next is asked as by another process."""

from twin.kernel import cache_folder as kept
from twin.kernel.places import sources


def forget_installation() -> None:
    """Of twin's source and the packages."""
    kept._packages.cache_clear()
    sources.cache_clear()
