"""Everything that the runs of a sweep stand on, made ready to travel: files by content, under names of their own.

An experiment names other files: those it extends, a body, drives with their mappings, FMUs. Here they become a folder
that needs nothing outside: one experiment file, bodies/, fmus/. Names that tell a reader something stay as they are, so
that runs and their recordings do not differ from those made where the files come from.
"""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twin.drive.setting import MOST_BYTES
from twin.experiment.drive_files import FILE, FOLDERS, JOINTS, MAPPING, joint_tables, shelved
from twin.experiment.source import KEPT, read_source, source_text
from twin.files import read_bytes
from twin.places import located
from twin.studies.sweep.plan import Task


@dataclass(frozen=True)
class Manifest:
    """What is in a bundle.

    Attributes:
        experiment: path in the bundle.
        files: path in the bundle -> SHA-256 of the content.
        originals: path in the bundle -> path on the machine it was packed on, for sentences.
    """

    experiment: str
    files: dict[str, str] = field(default_factory=dict)
    originals: dict[str, str] = field(default_factory=dict)


class Bundle:
    """The experiment at a path, and what its runs add to it as they are packed.

    Attributes:
        manifest: of what has been packed.
        contents: by SHA-256.

    Raises:
        InputRefused: a file cannot be read, or is not what it should be.
    """

    def __init__(self, experiment: Path):
        self.manifest = Manifest(f"{experiment.stem}.toml")
        self.contents: dict[str, bytes] = {}
        self._folder = experiment.resolve().parent
        self._drives: dict[str, str] = {}
        self._settings: dict[str, str] = {}
        self._names: dict[tuple[str, Path], str] = {}
        source = read_source(experiment)
        drive, contact = source.values.get("drive"), source.values.get("contact")
        if isinstance(drive, dict):
            for table in (drive, *(drive.get(joint) for joint in JOINTS)):
                self._pack_drive(table, self._folder, "")
        if isinstance(contact, dict) and isinstance(contact.get("body"), str):
            contact["body"] = self._body(contact["body"])
        for role in KEPT:
            table = source.values.get(role)
            if isinstance(table, dict) and isinstance(table.get("fmu"), str):
                table["fmu"] = self._drive(located(table["fmu"], self._folder), "")
            if isinstance(table, dict) and isinstance(table.get("python"), str):
                table["python"] = self._class(table["python"])
        self._put(self.manifest.experiment, source_text(source).encode(), experiment.absolute())

    def packed(self, task: Task) -> Task:
        """`task` as it travels: no more than its run needs, drive and settings by paths in the bundle.

        Raises:
            InputRefused: as for the experiment.
        """
        drive = task.drive
        if drive is not None and drive not in self._drives:
            self._drives[drive] = self._drive(Path(shelved(drive, self._folder)), "")
        settings = tuple(self._setting(text) for text in task.settings)
        return Task(task.run, "", None if drive is None else self._drives[drive], {}, settings)

    def _setting(self, text: str) -> str:
        """`text`, with a path in the bundle where it names a file."""
        if not text.endswith('"'):
            return text
        if text not in self._settings:
            key, _, value = text.partition("=")
            name, new = json.loads(value), None
            if key == "contact.body":
                new = self._body(name)
            elif key in (f"{role}.fmu" for role in KEPT):
                new = self._drive(located(name, self._folder), "")
            elif key in (f"{role}.python" for role in KEPT):
                new = self._class(name)
            elif key.startswith("drive.") and key.endswith(".fmu"):
                part = ".parts." in key
                new = self._fmu(name, self._folder, "") if part else self._drive(located(name, self._folder), "")
            elif isinstance(name, str) and name.startswith(FILE):
                new = self._file(name, self._folder, "")
            self._settings[text] = text if new is None else f"{key}={json.dumps(new)}"
        return self._settings[text]

    def _pack_drive(self, table: Any, folder: Path, into: str) -> None:
        """Pack what a table of a drive names, and name it anew in place.

        Args:
            folder: where the table's names are looked up.
            into: folder in the bundle where they will be.
        """
        if not isinstance(table, dict):
            return
        if isinstance(table.get("fmu"), str):
            table["fmu"] = self._drive(located(table["fmu"], folder), into)
        self._pack_files(table, folder, into)
        parts = table.get("parts")
        for part in parts.values() if isinstance(parts, dict) else ():
            if isinstance(part, dict) and isinstance(part.get("fmu"), str):
                part["fmu"] = self._fmu(part["fmu"], folder, into)
                self._pack_files(part, folder, into)

    def _pack_files(self, table: dict[str, Any], folder: Path, into: str) -> None:
        """Likewise the files among the parameters of `table`."""
        given = table.get("parameters")
        if not isinstance(given, dict):
            return
        for name, value in given.items():
            many = isinstance(value, (list, tuple))
            given[name] = [self._file(v, folder, into) for v in value] if many else self._file(value, folder, into)

    def _file(self, value: Any, folder: Path, into: str) -> Any:
        """A parameter as seen from `into`, which changes nothing but the name of a file."""
        if not (isinstance(value, str) and value.startswith(FILE)):
            return value
        path = located(value.removeprefix(FILE), folder)
        if (into, path) not in self._names:
            new = self._names[into, path] = self._free(path.name)
            self._put(f"{into}{new}", read_bytes(path, MOST_BYTES), path)
        return FILE + self._names[into, path]

    def _drive(self, path: Path, into: str) -> str:
        """The name, as seen from `into`, of the drive at `path`: an FMU, a mapping, or a folder with one of them."""
        mapping = path / MAPPING if path.is_dir() else path
        if not (mapping.suffix == ".toml" and mapping.is_file()):
            return self._fmu(str(path), path.parent, into)
        if (into, path) not in self._names:
            name = self._names[into, path] = self._free(path.name)
            inside = f"{into}{name}/{MAPPING}" if path.is_dir() else f"{into}{name}"
            source = read_source(mapping)
            self._pack_drive(source.values, mapping.parent.resolve(), inside.removesuffix(Path(inside).name))
            self._put(inside, source_text(source).encode(), mapping)
        return self._names[into, path]

    def _fmu(self, name: str, folder: Path, into: str) -> str:
        """Likewise of the FMU, or the folder with one, that is called `name` in `folder`."""
        path = located(name, folder)
        if (into, path) not in self._names:
            (table, *_) = joint_tables({"parts": {"it": {"fmu": name}}}, folder)
            archive = Path(table["parts"]["it"]["fmu"])
            new = self._names[into, path] = self._free(Path(name).name)
            self._put(f"{into}{new}/{archive.name}" if path.is_dir() else f"{into}{new}", archive.read_bytes(), archive)
        return self._names[into, path]

    def _class(self, name: str) -> str:
        """The name of a Python class as it travels: its file alone, not what that imports from beside it."""
        file, _, kind = name.rpartition(":")
        path = located(file, self._folder)
        if ("python", path) not in self._names:
            new = self._names["python", path] = f"python/{len(self.manifest.files)}/{path.name}"
            self._put(new, read_bytes(path, kind="Python file"), path)
        return f"{self._names['python', path]}:{kind}"

    def _body(self, name: str) -> str:
        if name.endswith(".toml"):
            path = located(name, self._folder)
            new = inside = f"bodies/{len(self.manifest.files)}/{path.name}"
        else:
            shelves = [located(shelf, self._folder) / f"{name}.toml" for shelf in FOLDERS]
            path = next((file for file in shelves if file.is_file()), shelves[0])
            new, inside = name, f"{FOLDERS[0]}/{name}.toml"
        self._put(inside, source_text(read_source(path)).encode(), path)
        return new

    def _free(self, name: str) -> str:
        """A name in fmus/ that is not taken and ends in `name`."""
        return f"fmus/{len(self.manifest.files)}/{name}"

    def _put(self, inside: str, content: bytes, original: Path) -> None:
        digest = hashlib.sha256(content).hexdigest()
        self.manifest.files[inside] = digest
        self.manifest.originals[inside] = str(original)
        self.contents[digest] = content
