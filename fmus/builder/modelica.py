"""A drive written in Modelica, translated to C by rumoca and compiled like the others."""

from pathlib import Path

from .archive import write_zip
from .compile import TARGETS, linked_library
from .drive import FMUS


def modelica_drive_names() -> list[str]:
    """Names of the drives written in Modelica, sorted: the folders that hold a .mo file."""
    return sorted(path.parent.name for path in FMUS.glob("*/*.mo"))


def pack_modelica_drive(name: str, scratch: Path, target: Path) -> None:
    """Translate the .mo file of drive `name` under `scratch`, compile for all platforms and pack into `target`.

    Raises:
        ModuleNotFoundError: rumoca is not installed.
        subprocess.CalledProcessError: the C compiler refused.
    """
    # only this drive needs it, and all others are to be built without it
    import rumoca

    [model] = (FMUS / name).glob("*.mo")
    rumoca.load(str(model)).codegen("fmi2").save_all(str(scratch))
    source = scratch / "sources" / f"{model.stem}.c"
    entries = {
        "modelDescription.xml": scratch / "modelDescription.xml",
        "documentation/README.md": FMUS / name / "README.md",
        f"sources/{source.name}": source,
        f"sources/{model.name}": model,
    }
    for platform in TARGETS:
        library = linked_library(model.stem, platform, [str(source)], scratch)
        entries[f"binaries/{platform}/{library.name}"] = library
    write_zip(target, entries)
