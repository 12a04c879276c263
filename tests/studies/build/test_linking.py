"""Libraries for platforms where they cannot be tried: what can be looked at from here."""

import importlib.util
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from tests.studies.build.binaries import Binary, binary, slices
from tests.studies.build.conftest import FIG4, MODULES, silent
from twin.kernel.compiled.machine import MATH_SYMBOLS
from twin.kernel.compiled.native import Native
from twin.kernel.errors import InputRefused
from twin.studies.build.fmu import build_fmu
from twin.studies.build.linking import HOST_PLATFORM, PLATFORMS
from twin.studies.build.part import PART_COMPONENTS

KINDS = {"so": "ELF", "dll": "PE", "dylib": "Mach-O"}
# what an instance needs beside mathematics
C_LIBRARY = {"malloc", "free", "strcmp", "snprintf", "vsnprintf"}
# the same things as others call them, and what a linker of macOS puts in
MACOS = {"__sincos_stret", "bzero", "__bzero", "dyld_stub_binder"}
ADDED = {"__dso_handle", "_mh_dylib_header"}


# ziglang makes its library for Windows once, which takes more than a minute
WITHOUT_WINDOWS = tuple(name for name in PLATFORMS if "windows" not in name)
ALL_PARTS = [pytest.param((part, tuple(PLATFORMS)), marks=pytest.mark.endurance) for part in PART_COMPONENTS]


@pytest.fixture(
    scope="module", params=[("estimator", WITHOUT_WINDOWS), *ALL_PARTS], ids=lambda one: f"{one[0]} {len(one[1])}"
)
def everywhere(built: Callable[..., Path], request: pytest.FixtureRequest) -> dict[str, Binary]:
    """The libraries of a part of Fig. 4, FMI 3.0, by platform."""
    pytest.importorskip("ziglang")
    part, platforms = request.param
    asked = (
        ("all",)
        if set(platforms) == set(PLATFORMS)
        else tuple(name for name in platforms if name != HOST_PLATFORM.name)
    )
    with zipfile.ZipFile(built(part, "3.0", platforms=asked)) as archive:
        names = [Path(name) for name in archive.namelist() if name.startswith("binaries/")]
        assert all(entry.compress_size < 100_000 for entry in archive.infolist())
        assert {path.parent.name for path in names} == set(platforms)
        return {path.parent.name: binary(archive.read(str(path))) for path in names}


def functions(fmi: str) -> set[str]:
    """All functions of the standard, as its own header has them."""
    header = Path(fmpy.__file__).parent / "c-code" / f"fmi{fmi}Functions.h"
    lines = [line for line in header.read_text().splitlines() if line.startswith("#define fmi") and "FullName" in line]
    return {line.split()[1] for line in lines if "(name)" not in line}


def test_each_platform_has_a_library_of_its_kind_and_processor(everywhere: dict[str, Binary]) -> None:
    for name, found in everywhere.items():
        assert (found.processor, found.kind) == (name.split("-")[0], KINDS[PLATFORMS[name].suffix])
    # without a signature, if one that says nothing of who signed, macOS on Arm loads nothing
    assert everywhere["aarch64-darwin"].signed


def test_a_library_gives_the_functions_of_the_standard_and_no_other(everywhere: dict[str, Binary]) -> None:
    for name, found in everywhere.items():
        assert found.exports - ADDED == functions("3"), name


def test_a_library_needs_the_systems_own_libraries_and_of_them_mathematics(everywhere: dict[str, Binary]) -> None:
    for name, found in everywhere.items():
        if found.kind == "PE":
            assert all(dll == "KERNEL32.dll" or dll.startswith("api-ms-win-crt-") for dll in found.libraries), name
            continue
        system = {"libm.so.6", "libc.so.6"} if found.kind == "ELF" else {"/usr/lib/libSystem.B.dylib"}
        assert found.libraries == system, name
        needed = {symbol for symbol in found.imports if not MATH_SYMBOLS.fullmatch(symbol)}
        assert needed <= C_LIBRARY | (MACOS if found.kind == "Mach-O" else set()), name


def test_no_step_counts_references_or_is_of_another_processor(everywhere: dict[str, Binary]) -> None:
    assert {platform for _, platform in MODULES} >= set(everywhere)
    for where, text in MODULES.items():
        for foreign in ("NRT_", "llvm.x86.", "llvm.aarch64.", "Py", "numba_"):
            assert foreign not in text, (where, foreign)


def test_fmi_2_has_both_processors_of_macos_in_one_library(built: Callable[..., Path]) -> None:
    pytest.importorskip("ziglang")
    file = built("encoder", platforms=("x86_64-darwin", "aarch64-darwin"))
    with zipfile.ZipFile(file) as archive, zipfile.ZipFile(built("encoder")) as alone:
        here, macos = (archive.read(f"binaries/{place}") for place in ("linux64/encoder.so", "darwin64/encoder.dylib"))
        # the library for here is the same whatever stands beside it
        assert alone.read("binaries/linux64/encoder.so") == here
    both = [binary(content) for content in slices(macos)]
    assert [found.processor for found in both] == ["x86_64", "aarch64"]
    for found in both:
        assert found.exports - ADDED == binary(here).exports
        assert {"fmi2Instantiate", "fmi2DoStep"} <= found.exports - ADDED <= functions("2")
    # and not the folder in which it was linked
    assert all(b"@rpath/encoder.dylib" in content for content in slices(macos))


@pytest.mark.parametrize(
    ("platform", "fmi", "sentence"),
    [
        ("x86_64-window", "2.0", "--platform x86_64-window: did you mean 'x86_64-windows'"),
        ("amiga", "2.0", "expected one of x86_64-linux, x86_64-windows, x86_64-darwin, aarch64-darwin, all"),
        ("aarch64-linux", "2.0", "FMI 2.0 has no folder for it; build it with --fmi 3"),
    ],
)
def test_a_platform_that_there_is_not_is_refused(tmp_path: Path, platform: str, fmi: str, sentence: str) -> None:
    with pytest.raises(InputRefused, match=sentence):
        build_fmu(FIG4, "encoder", fmi, [platform], tmp_path / "it.fmu", [], silent)
    assert list(tmp_path.iterdir()) == []


def test_without_ziglang_other_platforms_are_refused_before_anything_is_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(Native, "module", lambda step, symbol: pytest.fail("compiled"))
    with pytest.raises(InputRefused, match=r"it\.fmu: no C compiler for x86_64-windows; pip install ziglang"):
        build_fmu(FIG4, "encoder", "2.0", ["x86_64-windows"], tmp_path / "it.fmu", [], silent)
    assert list(tmp_path.iterdir()) == []
