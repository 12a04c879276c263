"""The line that `make` shows while pip works."""

import re
from pathlib import Path

from set_up import EXPECTED, Progress

SAID = """Obtaining file:///home/somebody/twin
Collecting numpy>=2.0 (from twin==1.0.0)
  Downloading numpy-2.4.6-cp311-cp311-manylinux_2_27_x86_64.whl.metadata (6.6 kB)
  Downloading numpy-2.4.6-cp311-cp311-manylinux_2_27_x86_64.whl (16.4 MB)
  Using cached mcap-1.2.2-py3-none-any.whl (500 kB)
Requirement already satisfied: packaging>=24
Processing /some/folder/pillow-13.0.0-cp311.whl
""".splitlines()


def test_packages_are_counted_once_and_megabytes_added():
    progress = Progress()
    assert "0 of about 50 packages, 0 s: asking for packages" in progress.text(50, 0.0)
    for line in SAID:
        progress.take(line)
    assert (progress.packages, round(progress.megabytes, 3)) == (3, 16.9)
    assert progress.text(6, 12.4) == f"  [{'#' * 12:24}] 3 of about 6 packages, 17 MB, 12 s: pillow"
    # more than foretold is not an end
    assert "] 3 of about 2 packages" in progress.text(2, 1.0) and "#" * 24 not in progress.text(2, 1.0)
    progress.take("Installing collected packages: numpy, mcap, pillow")
    assert progress.text(6, 60.0).endswith("] 3 packages, 17 MB, 60 s: unpacking")
    assert all(len(progress.text(10**6, 10.0**n)) < 80 for n in range(9))


def test_the_makefile_sets_up_by_it_and_what_it_foretells_are_extras_of_the_makefile(root: Path):
    makefile = (root / "Makefile").read_text()
    assert len(re.findall(r"^\t@\$\(VENV\)/bin/python set_up\.py", makefile, re.MULTILINE)) == 2
    (usual,) = re.findall(r"^EXTRAS \?= (.*)$", makefile, re.MULTILINE)
    assert EXPECTED.keys() == {"explore", usual}
