"""Files damaged as disks, backups and people do it."""

import os
import pickle
import random
import shutil
from pathlib import Path

KINDS = ("truncated", "emptied", "garbage", "flipped", "longer", "pickle", "folder", "link", "unreadable", "unchanged")
"""`unchanged`: another byte, but size and time as before."""


def damage(file: Path, kind: str, draw: random.Random) -> None:
    """Make of `file`, which is not empty, what `kind` says."""
    content, found = file.read_bytes(), file.stat()
    place = draw.randrange(len(content))
    flipped = content[:place] + bytes([content[place] ^ draw.randrange(1, 256)]) + content[place + 1 :]
    match kind:
        case "truncated":
            file.write_bytes(content[:place])
        case "emptied":
            file.write_bytes(b"")
        case "garbage":
            file.write_bytes(draw.randbytes(draw.randrange(1, 2000)))
        case "flipped":
            file.write_bytes(flipped)
        case "longer":
            file.write_bytes(content + draw.randbytes(draw.randrange(1, 40)))
        case "pickle":
            file.write_bytes(pickle.dumps(("0.0", {"no": "index"})))
        case "folder":
            file.unlink()
            (file / "something").mkdir(parents=True)
        case "link":
            file.unlink()
            file.symlink_to(file.parent / "nowhere")
        case "unreadable":
            file.write_bytes(flipped)
            file.chmod(0)
        case "unchanged":
            file.write_bytes(flipped)
            os.utime(file, ns=(found.st_atime_ns, found.st_mtime_ns))


def damaged_folder(folder: Path, draw: random.Random) -> None:
    """Remove `folder`, or put a file in its place."""
    shutil.rmtree(folder)
    if draw.random() < 0.5:
        folder.write_bytes(b"a file")
