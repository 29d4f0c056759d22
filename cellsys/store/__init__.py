"""Files: atomic writes, npz with a schema, chunked runs larger than memory, hashes, run cache."""

from cellsys.store.archive import load_archive, save_archive
from cellsys.store.atomic import atomic_path, write_json, write_text
from cellsys.store.hashing import fingerprint
from cellsys.store.memory import available_memory, check_memory, size_text
from cellsys.store.runs import RunReader, RunWriter, discard_partial, read_rows, release

__all__ = [
    "RunReader",
    "RunWriter",
    "atomic_path",
    "available_memory",
    "check_memory",
    "discard_partial",
    "fingerprint",
    "load_archive",
    "read_rows",
    "release",
    "save_archive",
    "size_text",
    "write_json",
    "write_text",
]
