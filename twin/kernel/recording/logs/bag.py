"""Reader of ROS 2 bags in MCAP or SQLite, compressed or not.

Layout: https://github.com/ros2/rosbag2. rosbags would read as much as a file claims; here memory and time are bounded
by the file's size. metadata.yaml only gives the names of expected files, since a killed recorder does not write it.
"""

import os
import re
import sqlite3
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import zstandard
from mcap.records import Channel, Schema

from twin.kernel.atomic_write import atomic_write
from twin.kernel.files import open_regular, read_text
from twin.kernel.recording.folder import LATEST_LINK, RECORDING_FILE
from twin.kernel.recording.logs import decoding
from twin.kernel.recording.logs.log import LogError, MappedColumn
from twin.kernel.recording.logs.topics import LoggedTopic, maps_topic, merge_topics, read_topics
from twin.kernel.recording.summary import MAX_UNPACK_RATIO, unpack_allowance

SQLITE_MAGIC = b"SQLite format 3\0"
HEAD_BYTES = 100
"""Size of SQLite's file header (https://sqlite.org/fileformat2.html)."""
BAG_SUFFIXES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
METADATA_FILE = "metadata.yaml"
MAX_FILE_BYTES = 2**36
MAX_MESSAGE_BYTES = 2**28
"""Maximum sizes of a file and of a message (bytes): 64 GB and 256 MB."""
MAX_DEFINITIONS = 200
DEFINITIONS_TABLE = "message_definitions"
"""Table with message definitions, since ROS 2 Iron."""
BAG_TABLES = ("topics", "messages", DEFINITIONS_TABLE)
MAX_STEPS_PER_BYTE = 4
"""Maximum steps of SQLite's virtual machine per byte of a file in one query; a message needs 30 and has 9 bytes."""
MIN_ROW_BYTES = 8
"""Minimum size of a message in a file."""
_SIZED_TYPES = {str, bytes}
_STORED_SQL = re.compile(r"CREATE (TABLE|INDEX|UNIQUE INDEX|TRIGGER)\b")
_FILE_LIST = re.compile(r"^\s*relative_file_paths:\s*\n((?:\s*-\s*\S.*\n)+)", re.MULTILINE)


def is_bag(path: Path) -> bool:
    """Check whether `path` is a ROS 2 bag: a folder with a bag, or one file of a bag other than a plain MCAP file."""
    if not os.path.isdir(path):
        return path.name.endswith((".db3", ".zstd"))
    # a run of twin is also an MCAP file in a folder
    own = (RECORDING_FILE, f"{RECORDING_FILE}.partial", LATEST_LINK)
    return not any(os.path.lexists(path / name) for name in own) and (
        os.path.lexists(path / METADATA_FILE) or bool(_files(path))
    )


def bag_topics(path: Path, columns: Mapping[str, MappedColumn]) -> tuple[dict[str, LoggedTopic], list[str]]:
    """Read the topics of all files of a ROS 2 bag, with the messages of `columns`, and notes on missing data."""
    folder = os.path.isdir(path)
    files = _files(path) if folder else [path]
    notes = _missing_files(path, files) if folder else []
    if not files:
        raise LogError(f"{path}: a bag without a file; {'; '.join(notes) or 'expected .db3 or .mcap in it'}")
    found: list[LoggedTopic] = []
    for file in files:
        with _plain_file(file) as plain:
            topics, note = (read_topics if plain.name.endswith(".mcap") else _sqlite_topics)(plain, columns, file)
        found += topics
        notes += [f"{file.name}: {note}"] if note else []
    for topic in found:
        _attach_definition(topic, path if folder else path.parent)
    return merge_topics(found), notes


def _files(folder: Path) -> list[Path]:
    """List the files of a bag, in any order, since their messages have times."""
    return sorted(folder / name for name in os.listdir(folder) if name.endswith(BAG_SUFFIXES))


def _missing_files(folder: Path, files: list[Path]) -> list[str]:
    """Create the note on files that are in the bag's own list but missing in the folder."""
    if not os.path.lexists(folder / METADATA_FILE):
        return [f"no {METADATA_FILE}: the recorder was stopped before it wrote one"]
    listed = _FILE_LIST.search(read_text(folder / METADATA_FILE))
    names = re.findall(r"-\s*[\"']?([^\"'\n]+?)[\"']?\s*\n", listed[1]) if listed else []
    there = {file.name for file in files} | {file.name.removesuffix(".zstd") for file in files}
    return [f"{name} is missing, which {METADATA_FILE} lists" for name in names if Path(name).name not in there]


@contextmanager
def _plain_file(file: Path) -> Iterator[Path]:
    try:
        with open_regular(file, MAX_FILE_BYTES) as content:
            if not file.name.endswith(".zstd"):
                yield file
                return
            most, done = unpack_allowance(os.fstat(content.fileno()).st_size), 0
            with tempfile.TemporaryDirectory(prefix="twin-bag-") as room:
                plain = Path(room) / file.name.removesuffix(".zstd")
                packed = zstandard.ZstdDecompressor().stream_reader(content)
                with atomic_write(plain) as beside, beside.open("wb") as out, packed:
                    while block := packed.read(2**20):
                        done += len(block)
                        if done > most:
                            raise LogError(
                                f"{file}: would unpack to more than {MAX_UNPACK_RATIO} times its size; expected a bag"
                            )
                        out.write(block)
                yield plain
    except zstandard.ZstdError as problem:
        raise LogError(f"{file}: does not decompress: {problem}; expected a bag compressed by zstd") from None


def _sqlite_topics(plain: Path, columns: Mapping[str, MappedColumn], file: Path) -> tuple[list[LoggedTopic], str]:
    """Read the topics of a bag's SQLite file `plain`, unpacked from `file`, and a note on an unfinished recording."""
    size = plain.stat().st_size
    with plain.open("rb") as start:
        head = start.read(HEAD_BYTES)
    if not head.startswith(SQLITE_MAGIC):
        raise LogError(f"{file}: {'not an SQLite file' if head else 'an empty file'}; expected a bag")
    page = max(1, int.from_bytes(head[len(SQLITE_MAGIC) : len(SQLITE_MAGIC) + 2], "big"))
    # 1 stands for a page of 64 KiB
    if size % (page if page > 1 else 2**16):
        raise LogError(f"{file}: damaged, it is cut off; recover what is readable first (sqlite3 {file.name} .recover)")
    unsaved = Path(f"{plain}-wal")
    pending = unsaved.is_file() and unsaved.stat().st_size > 0
    # immutable: the write-ahead log is ignored, and no file is written
    where = f"{plain.absolute().as_uri()}?mode=ro{'' if pending else '&immutable=1'}"
    size += unsaved.stat().st_size if pending else 0
    try:
        with closing(sqlite3.connect(where, uri=True)) as bag:
            bag.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(size, MAX_MESSAGE_BYTES))
            bag.execute("PRAGMA trusted_schema = OFF")
            topics = _read_topics(BagDatabase(bag, file, size), file, size, columns)
    except (sqlite3.Error, sqlite3.Warning, OverflowError, MemoryError, UnicodeError) as problem:
        raise LogError(
            f"{file}: damaged, or no bag: {problem}; recover what is readable first (sqlite3 {file.name} .recover)"
        ) from None
    return topics, f"what was left in {unsaved.name} is read too" if pending else ""


class BagDatabase:
    """Bounded reader of a bag's SQLite file: only stored rows, limited by `size`, the file's size in bytes.

    SQLite files can contain code: views, virtual tables and generated columns are computed by the reader, to any size
    and for any time. Pages may also refer to each other so that few of them contain any number of rows.
    """

    def __init__(self, bag: sqlite3.Connection, file: Path, size: int):
        self._bag, self._file, self._size = bag, file, size
        tables = []
        for kind, name, text in self.select("SELECT type, name, sql FROM sqlite_master"):
            # SQLite's own objects have no text; the text of others begins with their kind
            if text is not None and not _STORED_SQL.match(str(text)):
                raise LogError(f"{file}: has {str(text)[:40]!r}; bags of ROS 2 have stored tables only")
            tables += [str(name)] if kind == "table" else []
        columns = {table: list(self.select(f"PRAGMA table_xinfo({table})")) for table in BAG_TABLES}
        for table, described in columns.items():
            if not described and table != DEFINITIONS_TABLE:
                raise LogError(
                    f"{file}: has no table {table} as bags of ROS 2 have; it has {', '.join(tables) or 'none'}"
                )
            for _, name, *_, hidden in described:
                if hidden:
                    raise LogError(f"{file}: column {name} of table {table} is computed; expected a recorded one")
        self.has_definitions = bool(columns[DEFINITIONS_TABLE])

    def select(self, query: str) -> Iterator[tuple[Any, ...]]:
        """Run a query on the bag's database, and yield its rows."""
        every = 1000
        left = 100 + MAX_STEPS_PER_BYTE * self._size // every

        def step() -> bool:
            nonlocal left
            left -= 1
            return left < 0

        self._bag.set_progress_handler(step, every)
        total = 0
        try:
            for row in self._bag.execute(query):
                total += sum(len(value) for value in row if type(value) in _SIZED_TYPES)
                if total > self._size:
                    raise LogError(f"{self._file}: damaged: rows of more bytes than it has; expected a bag")
                yield row
        except sqlite3.OperationalError:
            if left < 0:
                raise LogError(f"{self._file}: damaged: more rows than it has room for; expected a bag") from None
            raise


def _read_topics(rows: BagDatabase, file: Path, size: int, columns: Mapping[str, MappedColumn]) -> list[LoggedTopic]:
    definitions: dict[str, tuple[str, str]] = {}
    if rows.has_definitions:
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        definitions = {kind: (encoding, text) for kind, encoding, text in rows.select(query)}
    topics: dict[int, LoggedTopic] = {}
    chosen_ids: set[int] = set()
    for number, name, kind, form in rows.select("SELECT id, name, type, serialization_format FROM topics"):
        if not isinstance(number, int) or not all(isinstance(text, str) for text in (name, kind, form)):
            raise LogError(
                f"{file}: topic {number} has a name, type or format that is neither text nor a number; expected a bag"
            )
        encoding, text = definitions.get(kind, ("", ""))
        schema = Schema(0, str(text or "").encode("utf-8", "replace"), str(encoding), kind)
        topics[number] = LoggedTopic(Channel(0, name, form, {}, 0), schema)
        if maps_topic(name, columns):
            chosen_ids.add(number)
    chosen = ", ".join(map(str, chosen_ids))
    query = f"SELECT topic_id, timestamp, CASE WHEN topic_id IN ({chosen}) THEN data END FROM messages ORDER BY id"
    for row, (number, time, data) in enumerate(rows.select(query)):
        if row * MIN_ROW_BYTES > size:
            raise LogError(f"{file}: damaged: more rows than it has room for; expected a bag")
        if number not in topics or not isinstance(time, int) or time < 0:
            raise LogError(f"{file}: a message of topic {number} at time {time!r}; expected a topic that is there")
        topics[number].times.append(time)
        if number in chosen_ids:
            if not isinstance(data, bytes):
                raise LogError(
                    f"{file}: a message of {topics[number].channel.topic} holds {data!r:.40}; expected bytes"
                )
            topics[number].data.append(data)
    return list(topics.values())


def _attach_definition(topic: LoggedTopic, folder: Path) -> None:
    """Define a topic's message type from `PACKAGE/msg/NAME.msg` files in the bag's folder."""
    schema = topic.schema
    if not topic.data or schema is None or schema.data or decoding.is_known(schema.name):
        return
    files = sorted(folder.glob("*/msg/*.msg"))[:MAX_DEFINITIONS]
    texts = {f"{file.parent.parent.name}/msg/{file.stem}": read_text(file) for file in files}
    if schema.name in texts:
        own = texts.pop(schema.name)
        others = "".join(f"{'=' * 80}\nMSG: {name}\n{text.rstrip()}\n" for name, text in texts.items())
        topic.schema = Schema(0, f"{own.rstrip()}\n{others}".encode(), "ros2msg", schema.name)
