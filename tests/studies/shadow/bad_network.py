"""Two network namespaces with a wire between them that loses and delays, for processes that talk by DDS."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

_INTERFACE = "<General><Interfaces><NetworkInterface name='{}'/></Interfaces></General>"
NETWORK = f"<CycloneDDS><Domain>{_INTERFACE}</Domain></CycloneDDS>"
"""CYCLONEDDS_URI of a process in a namespace, whose end of the wire is wire0 or wire1."""


def lacking(what: str) -> None:
    """Skip a test for want of a package; CI has to have it."""
    assert "CI" not in os.environ, f"CI has to have {what}"
    pytest.skip(f"needs {what}")


@contextmanager
def bad_network(
    first: str, second: str, subnet: str, wire: Sequence[object], before: Sequence[str] = ()
) -> Iterator[None]:
    """Make namespaces with the addresses `subnet`.1 and .2, and remove them; skip the test where that is not allowed.

    Args:
        wire: arguments of bad_wire.py after the names of the namespaces.
        before: words before its command line.
    """
    if shutil.which("ip") is None:
        lacking("iproute2")
    names = (first, second)
    words = [*before, sys.executable, Path(__file__).with_name("bad_wire.py"), *names, *wire]
    for name in names:
        # left by a test that was killed
        _done(f"ip netns del {name}")
    done = [_done(f"ip netns add {name}") for name in names]
    relay = subprocess.Popen([*map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert relay.stdout is not None and relay.stderr is not None
        if not all(done) or relay.stdout.readline() != "ready\n":
            # a right that no package brings
            pytest.skip(f"no network of its own here: {relay.stderr.read() if relay.poll() else 'ip netns'}")
        for k, name in enumerate(names):
            assert _done(f"ip -n {name} addr add {subnet}.{k + 1}/24 dev wire{k}")
            assert _done(f"ip -n {name} link set wire{k} up")
            # Cyclone DDS ends its receiving thread by a message to its own address
            assert _done(f"ip -n {name} link set lo up")
        yield
    finally:
        relay.kill()
        relay.communicate()
        for name in names:
            _done(f"ip netns del {name}")


def _done(command: str) -> bool:
    return subprocess.run(command.split(), capture_output=True, check=False).returncode == 0
