"""Cross-compilation of a drive for every platform of FMI 2.0 with the C compiler of the ziglang package."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from struct import pack

from .c_table import variables_header, variables_table
from .drive import FMI2, Drive

# glibc 2.17 (2012) is the oldest that ziglang's headers support well; newer systems run it unchanged
TARGETS = {
    "linux64": ("so", ["x86_64-linux-gnu.2.17"]),
    "win64": ("dll", ["x86_64-windows-gnu"]),
    "darwin64": ("dylib", ["x86_64-macos", "aarch64-macos"]),
}
# no fast-math, no contraction to fused multiply-add: the same numbers on every platform, up to its libm
FLAGS = "-std=c11 -O2 -ffp-contract=off -fvisibility=hidden -Wall -Wextra -Werror -shared -s".split()

# Mach-O: cputype, cpusubtype, log2 of the page size
MACHO_SLICES = {"x86_64-macos": (0x01000007, 3, 12), "aarch64-macos": (0x0100000C, 0, 14)}


def write_generated(drive: Drive, folder: Path) -> None:
    """Write variables.h and variables.c of the drive into `folder`, creating it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "variables.h").write_text(variables_header(drive), encoding="utf-8")
    (folder / "variables.c").write_text(variables_table(drive), encoding="utf-8")


def shared_library(drive: Drive, platform: str, folder: Path) -> Path:
    """Compile the drive, whose generated files are in `folder`, for one platform of TARGETS.

    Raises:
        subprocess.CalledProcessError: the compiler refused; its messages are on stderr.
    """
    suffix, triples = TARGETS[platform]
    library = folder / platform / f"{drive.name}.{suffix}"
    library.parent.mkdir(parents=True, exist_ok=True)
    if len(triples) == 1:
        _compile(drive, triples[0], folder, library)
    else:
        slices = {triple: library.with_suffix(f".{triple}") for triple in triples}
        for triple, path in slices.items():
            _compile(drive, triple, folder, path)
        library.write_bytes(universal_binary({triple: path.read_bytes() for triple, path in slices.items()}))
    return library


def universal_binary(slices: dict[str, bytes]) -> bytes:
    """Join Mach-O libraries, by target triple, into one (layout: <mach-o/fat.h>, big-endian)."""
    header = pack(">II", 0xCAFEBABE, len(slices))
    body = b""
    start = 8 + 20 * len(slices)
    for triple, content in slices.items():
        cpu, subtype, alignment = MACHO_SLICES[triple]
        body += bytes(-(start + len(body)) % (1 << alignment))
        header += pack(">IIIII", cpu, subtype, start + len(body), len(content), alignment)
        body += content
    return header + body


def _compile(drive: Drive, triple: str, folder: Path, library: Path) -> None:
    fmpy = find_spec("fmpy")
    if fmpy is None or fmpy.origin is None:
        raise ModuleNotFoundError("fmpy is not installed: the FMI 2.0 headers come with it")
    headers = Path(fmpy.origin).parent / "c-code"
    model = next(path for path in drive.sources if path.name == "model.c")
    sources = [model, *sorted(FMI2.glob("*.c")), folder / "variables.c"]
    includes = [f"-I{path}" for path in (folder, FMI2)] + ["-isystem", str(headers)]
    libraries = [] if "windows" in triple else ["-lm"]
    compiler = [sys.executable, "-m", "ziglang", "cc", "-target", triple]
    subprocess.run([*compiler, *FLAGS, *includes, *map(str, sources), *libraries, "-o", str(library)], check=True)
