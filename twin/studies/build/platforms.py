"""Platforms that machine code is written for."""

from collections.abc import Sequence
from typing import NamedTuple

from twin.errors import InputRefused, nearest

ALL = "all"


class Form(NamedTuple):
    """Machine code for what not every processor of a kind has; `processor_form` of part.c chooses among them.

    Attributes:
        suffix: of the names of functions.
        features: that LLVM may use.
    """

    suffix: str
    features: str


X86_64 = (Form("", ""), Form("_avx", "+avx"), Form("_avx512", "+avx512f,+avx512vl"))
"""Fig. 4's plant takes 1.14, 1.09 and 1.02 times as long as what is compiled for the processor on which it runs."""
ARM = (Form("", ""),)


class Platform(NamedTuple):
    """A processor and a system.

    Attributes:
        name: its tuple in FMI 3.0, which is its folder there.
        fmi2: its folder in FMI 2.0; None: that has none.
        suffix: of shared libraries.
        triple: what LLVM calls it.
        target: what the compiler of ziglang calls it. glibc 2.17 is of 2012, macOS 11 the first for both processors;
            what is linked against them runs on every system since.
        cpu: the oldest processor of this kind.
        forms: in which its code is written.
    """

    name: str
    fmi2: str | None
    suffix: str
    triple: str
    target: str
    cpu: str
    forms: tuple[Form, ...]

    @property
    def is_elf(self) -> bool:
        """Whether its libraries are of the kind that Linux has."""
        return self.suffix == "so"


PLATFORMS = {
    row[0]: Platform(*row)
    for row in (
        ("x86_64-linux", "linux64", "so", "x86_64-unknown-linux-gnu", "x86_64-linux-gnu.2.17", "x86-64", X86_64),
        ("aarch64-linux", None, "so", "aarch64-unknown-linux-gnu", "aarch64-linux-gnu.2.17", "generic", ARM),
        ("x86_64-windows", "win64", "dll", "x86_64-unknown-windows-gnu", "x86_64-windows-gnu", "x86-64", X86_64),
        ("x86_64-darwin", "darwin64", "dylib", "x86_64-apple-macosx11.0.0", "x86_64-macos.11.0", "x86-64", X86_64),
        ("aarch64-darwin", "darwin64", "dylib", "arm64-apple-macosx11.0.0", "aarch64-macos.11.0", "generic", ARM),
    )
}
HERE = PLATFORMS["x86_64-linux"]
"""Where it is built, and the only one where it can be tried."""


def platforms_named(names: Sequence[str], fmi: str | None = None) -> list[Platform]:
    """The platform where it is built, and those of `names` beside it; "all" are all.

    Args:
        names: tuples of FMI 3.0.
        fmi: for which version; None: for no FMU.

    Raises:
        InputRefused: there is no such platform, or FMI 2.0 knows no folder for it.
    """
    able = {name: platform for name, platform in PLATFORMS.items() if platform.fmi2 or fmi != "2.0"}
    for name in names:
        if name == ALL or name in able:
            continue
        if name in PLATFORMS:
            raise InputRefused(f"--platform {name}: FMI 2.0 has no folder for it; build it with --fmi 3")
        raise InputRefused(f"--platform {name}: {nearest(name, [*able, ALL], 'expected one of {}')}")
    return [p for name, p in able.items() if p is HERE or ALL in names or name in names]
