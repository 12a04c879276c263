"""Libraries for several platforms, linked from C and from object files of compiled steps.

Any C compiler serves for the build machine; other platforms need the package ziglang, which includes the headers and
libraries of them all.

The object files are emitted from the modules of `twin.kernel.compiled.machine`. Such a module is platform independent:
its types fix the size of its numbers, pointers have 64 bits, and its interface consists of pointers and doubles, which
every C ABI passes in the same way. So LLVM can emit it for any platform. LLVM ends the process if it cannot emit
code for a platform: the caller must survive that.
"""

import hashlib
import importlib.util
import os
import platform as machine
import shutil
import struct
import sys
import tempfile
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm

from twin.kernel.compiled.machine import BASELINE_CPU, X86_64, Module, ProcessorForm, strip_module
from twin.kernel.errors import InputRefused, nearest, translate_disk_errors
from twin.kernel.fmi.unpacked import COMPILE_TIMEOUT, ZIG_PACKAGE, call_compiler, compiler_command, zig_command
from twin.studies.build.layout import Layout

ALL_PLATFORMS = "all"


ARM_FORMS = (ProcessorForm("", ""),)
# no contraction to fused multiply-add: results must equal the twin's
COMPILER_FLAGS = ("-std=c11", "-O2", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden", "-w")
GUID_NAMESPACE = uuid.UUID("0c2f7c0e-6b0e-5d56-9a57-6a0f6f1f3c55")
C_FOLDER = Path(__file__).parent / "c"
# Mach-O fields by the first word of a triple: cputype, cpusubtype (<mach/machine.h>), log2 of the page size
_MACHO_FIELDS = {"x86_64": (0x01000007, 3, 12), "arm64": (0x0100000C, 0, 14)}


class Platform(NamedTuple):
    """A target platform of an exported part: a processor and an operating system.

    Attributes:
        name, fmi2: folder in FMI 3.0, and in FMI 2.0; None if FMI 2.0 lacks the platform.
        suffix: suffix of shared libraries.
        triple, target: names for LLVM and ziglang. glibc 2.17 is of 2012, macOS 11 the first for both processors; a
            library linked against them runs on every later system.
        cpu: the oldest processor of this kind.
        forms: variants of the compiled code.
    """

    name: str
    fmi2: str | None
    suffix: str
    triple: str
    target: str
    cpu: str
    forms: tuple[ProcessorForm, ...]

    @property
    def is_elf(self) -> bool:
        return self.suffix == "so"


PLATFORMS = {
    row[0]: Platform(*row)
    for row in (
        ("x86_64-linux", "linux64", "so", "x86_64-unknown-linux-gnu", "x86_64-linux-gnu.2.17", BASELINE_CPU, X86_64),
        ("aarch64-linux", None, "so", "aarch64-unknown-linux-gnu", "aarch64-linux-gnu.2.17", "generic", ARM_FORMS),
        ("x86_64-windows", "win64", "dll", "x86_64-unknown-windows-gnu", "x86_64-windows-gnu", BASELINE_CPU, X86_64),
        ("x86_64-darwin", "darwin64", "dylib", "x86_64-apple-macosx11.0.0", "x86_64-macos.11.0", BASELINE_CPU, X86_64),
        ("aarch64-darwin", "darwin64", "dylib", "arm64-apple-macosx11.0.0", "aarch64-macos.11.0", "generic", ARM_FORMS),
    )
}
HOST_PLATFORM = PLATFORMS["x86_64-linux"]
"""The build platform, and the only one whose libraries can be tested."""


def select_platforms(names: Sequence[str], fmi: str | None = None) -> list[Platform]:
    """Return the build platform and the requested target platforms; "all" selects every one that `fmi` supports."""
    able = {name: platform for name, platform in PLATFORMS.items() if platform.fmi2 or fmi != "2.0"}
    for name in names:
        if name == ALL_PLATFORMS or name in able:
            continue
        if name in PLATFORMS:
            raise InputRefused(f"--platform {name}: FMI 2.0 has no folder for it; build it with --fmi 3")
        raise InputRefused(f"--platform {name}: {nearest(name, [*able, ALL_PLATFORMS], 'expected one of {}')}")
    return [p for name, p in able.items() if p is HOST_PLATFORM or ALL_PLATFORMS in names or name in names]


def names_of(platforms: Iterable[Platform]) -> str:
    return ", ".join(platform.name for platform in platforms)


def summary(title: str, rows: Mapping[str, str]) -> str:
    return "\n".join([title, *(f"  {label:<8} {text}" for label, text in rows.items())])


class EmittedStep(NamedTuple):
    """A component's compiled step for one platform: symbol, LLVM text, object file."""

    symbol: str
    text: str
    content: bytes


def emit_step(step: Module, platform: Platform, form: ProcessorForm) -> EmittedStep:
    """Compile a component's step for another platform to an object file with a C function.

    Its signature is `int symbol(int32 *, void **, void *self, double t, double h, const double *u, double *y)`.

    Raises:
        InputRefused: the step needs more than mathematics, e.g. memory of its own.
    """
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    # numba's code model is for code at any address
    machine = llvm.Target.from_triple(platform.triple).create_target_machine(
        cpu=platform.cpu, features=form.features, opt=3, reloc="pic", codemodel="default"
    )
    module, foreign = strip_module(step, machine)
    if foreign:
        raise InputRefused(f"{step.symbol}: its compiled step needs {', '.join(foreign)}; it cannot leave Python")
    function = module.get_function(step.inner)
    # hidden, because two parts in one process have steps of the same name
    function.name, function.visibility = step.symbol + form.suffix, "hidden"
    return EmittedStep(function.name, str(module), machine.emit_object(module))


def emit_steps(
    layout: Layout, platforms: Sequence[Platform], say: Callable[[str], None]
) -> dict[Platform, list[EmittedStep]]:
    """Compile all steps of an exported part for each platform, in all variants of the code."""
    modules = []
    for row in layout.rows:
        say(f"compiling {row.component.name}")
        step: Any = row.step
        modules.append(step.module(row.symbol))
    return {
        platform: [emit_step(module, platform, form) for module in modules for form in platform.forms]
        for platform in platforms
    }


def object_files(steps: Sequence[EmittedStep]) -> dict[str, bytes]:
    return {f"{step.symbol}.o": step.content for step in steps}


def link_all(
    platforms: Sequence[Platform], link: Callable[[Platform], bytes], say: Callable[[str], None]
) -> dict[Platform, bytes]:
    """Link a library for each platform, in parallel."""
    say("linking")
    with ThreadPoolExecutor() as threads:
        return dict(zip(platforms, threads.map(link, platforms), strict=True))


def c_files(*names: str) -> dict[str, bytes]:
    """Return the named ones of the C files shared by all exported parts, as name -> content."""
    return {name: (C_FOLDER / name).read_bytes() for name in names}


def guid_of(*contents: bytes) -> str:
    digest = hashlib.sha256()
    for content in contents:
        digest.update(f"{len(content)}\n".encode() + content)
    return "{" + str(uuid.uuid5(GUID_NAMESPACE, digest.hexdigest())) + "}"


def refuse_platform(wanted: Path, platforms: Sequence[Platform]) -> None:
    """Refuse to build unless on x86-64 Linux with a compiler for every target platform."""
    if sys.platform != "linux" or machine.machine() not in ("x86_64", "AMD64"):
        here = f"{machine.machine()} {machine.system()}"
        raise InputRefused(f"{wanted}: native code is built on x86-64 Linux; this is {here}")
    for platform in platforms:
        _compiler(platform, wanted)


def shared_library(
    name: str, source: str, platform: Platform, files: Mapping[str, bytes], options: Sequence[str], wanted: Path
) -> bytes:
    """Compile a C file of `files`, with its includes, and link it with their object files to a shared library."""
    # refuse undefined symbols that the system's own libraries lack
    elf = ("-Wl,-z,now", "-Wl,-z,defs", "-lm")
    # the default install name is the path of the build
    macos = ("-install_name", f"@rpath/{name}.dylib")
    linking = {"so": elf, "dll": (), "dylib": macos}[platform.suffix]
    library = f"{name}.{platform.suffix}"
    with _folder_of(files) as folder:
        # relative, because the path would be embedded in the library
        inputs = [source, *(file for file in files if file.endswith(".o"))]
        flags = [*COMPILER_FLAGS, "-shared", "-s", "-I.", *options]
        _call([*_compiler(platform, wanted), *flags, *inputs, *linking, "-o", library], folder, wanted)
        return (folder / library).read_bytes()


def static_library(source: str, platform: Platform, files: Mapping[str, bytes], wanted: Path) -> bytes:
    """Compile a C file and archive it with object files to a static library that needs at most libm."""
    # no hardening that needs a system's C library
    bare = ("-fno-stack-protector", "-U_FORTIFY_SOURCE", "-fno-strict-aliasing")
    built = Path(source).with_suffix(".o").name
    with _folder_of(files) as folder:
        tool = _compiler(platform, wanted)
        _call([*tool, *COMPILER_FLAGS, *bare, "-I.", "-c", source, "-o", built], folder, wanted)
        objects = [built, *(file for file in files if file.endswith(".o"))]
        # D: deterministic, without times and owners
        _call([*_archiver(tool, wanted), "rcsD", "library.a", *objects], folder, wanted)
        return (folder / "library.a").read_bytes()


def universal(slices: Mapping[str, bytes]) -> bytes:
    """Combine macOS libraries of several processors, by triple, to one universal library, see <mach-o/fat.h>."""
    header = struct.pack(">II", 0xCAFEBABE, len(slices))
    body, start = b"", 8 + 20 * len(slices)
    for triple, content in slices.items():
        cpu, subtype, alignment = _MACHO_FIELDS[triple.partition("-")[0]]
        body += bytes(-(start + len(body)) % (1 << alignment))
        header += struct.pack(">IIIII", cpu, subtype, start + len(body), len(content), alignment)
        body += content
    return header + body


def _compiler(platform: Platform, wanted: Path) -> list[str]:
    tool = compiler_command(wanted) if platform is HOST_PLATFORM else [*zig_command(), "cc"]
    if platform is not HOST_PLATFORM and importlib.util.find_spec(ZIG_PACKAGE) is None:
        raise InputRefused(f"{wanted}: no C compiler for {platform.name}; pip install {ZIG_PACKAGE}")
    return [*tool, "-target", platform.target] if ZIG_PACKAGE in tool else tool


def _archiver(tool: Sequence[str], wanted: Path) -> list[str]:
    if ZIG_PACKAGE in tool:
        return [*zig_command(), "ar"]
    found = shutil.which("ar")
    if found is None:
        raise InputRefused(f"{wanted}: the C compiler lacks 'ar'; install binutils")
    return [os.path.abspath(found)]


@contextmanager
def _folder_of(files: Mapping[str, bytes]) -> Iterator[Path]:
    with (
        translate_disk_errors(Path(tempfile.gettempdir()), "cannot be written to"),
        tempfile.TemporaryDirectory(prefix="twin-build-") as scratch,
    ):
        for file, content in files.items():
            (Path(scratch) / file).write_bytes(content)
        yield Path(scratch)


def _call(command: Sequence[str], folder: Path, wanted: Path) -> None:
    call_compiler(
        command,
        f"{wanted}: does not compile",
        f"{wanted}: its C still compiles after {COMPILE_TIMEOUT:g} s; try another compiler",
        folder,
    )
