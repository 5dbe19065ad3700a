"""Atomic writing of files, and files that are whole or not read."""

import hashlib
import os
import tempfile
from pathlib import Path

from .errors import InputError


def write_whole(path: Path | str, text: str | bytes) -> Path:
    """Write `text` to `path` atomically: an interruption leaves the former file or none, never a part of the new one.

    **Raises:** `InputError` if it cannot be written.
    """
    path = Path(path)
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(text.encode() if isinstance(text, str) else text)
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        what = f"Cannot write ({error.strerror})"
        raise InputError(what, str(path), "name a file in a folder you may write to") from None
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
    return path


def write_sealed(path: Path, content: bytes) -> None:
    """Write the SHA-256 of `content`, and `content`, to `path` atomically.

    **Raises:** `InputError` if it cannot be written.
    """
    write_whole(path, hashlib.sha256(content).digest() + content)


def read_sealed(path: Path) -> bytes | None:
    """What `write_sealed` wrote to the file `path`; None where there is no file, or it is damaged."""
    try:
        whole = path.read_bytes()
    except OSError:
        return None
    size = hashlib.sha256().digest_size
    return whole[size:] if whole[:size] == hashlib.sha256(whole[size:]).digest() else None


def require_writable(path: Path | str) -> None:
    """Check before a computation that a file at `path` can be written. **Raises:** `InputError` if it cannot."""
    path = Path(path).absolute()
    existing_parent = next(parent for parent in path.parents if parent.exists())
    if path.is_dir() or not existing_parent.is_dir() or not os.access(existing_parent, os.W_OK | os.X_OK):
        raise InputError("Cannot write there", str(path), "name a file in a folder you may write to")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
