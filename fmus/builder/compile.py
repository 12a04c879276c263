"""Cross-compilation of a drive for every platform with the C compiler of the ziglang package."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from struct import pack

from .c_table import variables_header, variables_table
from .drive import FMI2, FMI3, Drive

# By platform folder of FMI 2.0: the library's suffix and the compiler's targets. glibc 2.17 is of 2012 and
# macOS 11 the first for both processors; newer systems run the same binary. Windows 10 is the first with the
# C runtime that the dll asks for.
TARGETS = {
    "linux64": ("so", ["x86_64-linux-gnu.2.17"]),
    "win64": ("dll", ["x86_64-windows-gnu"]),
    "darwin64": ("dylib", ["x86_64-macos.11.0", "aarch64-macos.11.0"]),
}
# The same by platform tuple of FMI 3.0, which keeps the processors of macOS apart.
TARGETS_FMI3 = {
    "x86_64-linux": ("so", ["x86_64-linux-gnu.2.17"]),
    "x86_64-windows": ("dll", ["x86_64-windows-gnu"]),
    "x86_64-darwin": ("dylib", ["x86_64-macos.11.0"]),
    "aarch64-darwin": ("dylib", ["aarch64-macos.11.0"]),
}
# no fast-math, no contraction to fused multiply-add: the same numbers on every platform, up to its libm
FLAGS = ["-std=c11", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-shared", "-s"]
WARNINGS = ["-Wall", "-Wextra", "-Werror"]

# Mach-O by processor: cputype, cpusubtype (<mach/machine.h>), log2 of the page size
MACHO = {"x86_64": (0x01000007, 3, 12), "aarch64": (0x0100000C, 0, 14)}


def write_generated(drive: Drive, folder: Path) -> None:
    """Write variables.h and variables.c of the drive into `folder`, creating it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "variables.h").write_text(variables_header(drive), encoding="utf-8")
    (folder / "variables.c").write_text(variables_table(drive), encoding="utf-8")


def shared_library(drive: Drive, platform: str, folder: Path) -> Path:
    """Compile the drive, whose generated files are in `folder`, for one platform of TARGETS or TARGETS_FMI3.

    Raises:
        subprocess.CalledProcessError: the compiler refused; its messages are on stderr.
    """
    own = [path for path in drive.sources if path.parent not in (FMI2, FMI3) and path.suffix == ".c"]
    ceremony = {"2.0": [FMI2], "3.0": [FMI3, FMI2]}[drive.fmi]
    sources = [*own, *sorted(ceremony[0].glob("*.c")), folder / "variables.c"]
    includes = [f"-I{path}" for path in (folder, *ceremony)] + ["-isystem", str(_fmi_headers())]
    return linked_library(drive.name, platform, [*WARNINGS, *includes, *map(str, sources)], folder)


def linked_library(identifier: str, platform: str, arguments: list[str], folder: Path) -> Path:
    """Compile C for one platform of TARGETS or TARGETS_FMI3 into `<folder>/<platform>/<identifier>.<suffix>`.

    Args:
        identifier: modelIdentifier of the FMU. arguments: sources, includes and warnings for the compiler.

    Raises:
        subprocess.CalledProcessError: the compiler refused; its messages are on stderr.
    """
    suffix, triples = (TARGETS | TARGETS_FMI3)[platform]
    library = folder / platform / f"{identifier}.{suffix}"
    library.parent.mkdir(parents=True, exist_ok=True)
    if len(triples) == 1:
        _compile(triples[0], arguments, library)
    else:
        slices = {}
        for triple in triples:
            processor = triple.split("-")[0]
            path = library.with_suffix(f".{processor}")
            _compile(triple, arguments, path)
            slices[processor] = path.read_bytes()
        library.write_bytes(universal_binary(slices))
    return library


def universal_binary(slices: dict[str, bytes]) -> bytes:
    """Join Mach-O libraries, by processor (keys of MACHO), into one (layout: <mach-o/fat.h>, big-endian)."""
    header = pack(">II", 0xCAFEBABE, len(slices))
    body = b""
    start = 8 + 20 * len(slices)
    for processor, content in slices.items():
        cpu, subtype, alignment = MACHO[processor]
        body += bytes(-(start + len(body)) % (1 << alignment))
        header += pack(">IIIII", cpu, subtype, start + len(body), len(content), alignment)
        body += content
    return header + body


def _fmi_headers() -> Path:
    fmpy = find_spec("fmpy")
    if fmpy is None or fmpy.origin is None:
        raise ModuleNotFoundError("fmpy is not installed: the FMI headers come with it")
    return Path(fmpy.origin).parent / "c-code"


def _compile(triple: str, arguments: list[str], library: Path) -> None:
    linking = [] if "windows" in triple else ["-lm"]
    if "macos" in triple:
        # by default the absolute path of the output, which would tell one checkout from another
        linking += ["-install_name", f"@rpath/{library.stem}.dylib"]
    compiler = [sys.executable, "-m", "ziglang", "cc", "-target", triple, *FLAGS]
    subprocess.run([*compiler, *arguments, *linking, "-o", str(library)], check=True)
