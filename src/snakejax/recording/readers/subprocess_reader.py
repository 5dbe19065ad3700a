"""Reading by a library of another language in a process of its own, so that a damaged file can only end that one.

The library may crash, hang, or ask for any amount of memory; the user gets one line.
"""

import importlib
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from snakejax.core.errors import InputError

from .cells import shown

MEMORY = 1 << 30
MEMORY_A_BYTE = 24
SECONDS = 9.0
BYTES_A_SECOND = 1e6
"""Limits of the process, chosen by us: bytes of memory, bytes for each byte of the file, seconds, and bytes of the file
that are read in a second."""
_CHILD = "from snakejax.recording.readers.subprocess_reader import child; child()"


def read_in_subprocess(
    module: str, path: Path, library: str, remedy: str = "export it again; it may be damaged"
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What `load(path)` of the reader `module` returns: facts that JSON can hold, and arrays by name.

    **Raises:** `InputError` where `library` is not installed, or cannot read the file, which `remedy` is for.
    """
    if importlib.util.find_spec(library) is None:
        what = f"Reading this format needs the library {library}"
        raise InputError(what, str(path), f"install it with pip install {library}")
    size = _size(path)
    seconds = SECONDS + size / BYTES_A_SECOND
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.npz"
        command = [sys.executable, "-c", _CHILD, module, str(path), str(result), str(MEMORY + MEMORY_A_BYTE * size)]
        paths = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
        environment = {**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        try:
            done = subprocess.run(command, env=environment, capture_output=True, timeout=seconds, check=False)
        except subprocess.TimeoutExpired:
            what = f"{library} did not finish reading it within {seconds:.0f} s"
            raise InputError(what, str(path), remedy) from None
        if done.returncode:
            raise InputError(f"{library} crashed on it", str(path), remedy)
        if not result.is_file():
            complaint = json.loads(done.stdout.decode().splitlines()[-1])
            if isinstance(complaint, str):
                raise InputError(f"{library} cannot read it ({complaint})", str(path), remedy)
            raise InputError(*complaint)
        with np.load(result, allow_pickle=False) as saved:
            arrays = {name: saved[name] for name in saved.files}
    return json.loads(arrays.pop("facts").tobytes()), arrays


def child() -> None:
    """What the other process does: `load` the file and save what it found, or print the complaint."""
    _, module, path, result, memory = sys.argv
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (int(memory), int(memory)))
    except (ImportError, ValueError, OSError):
        pass  # Not all systems limit memory; the time is limited everywhere.
    try:
        facts, arrays = importlib.import_module(f"snakejax.recording.readers.{module}").load(Path(path))
    except InputError as error:
        complaint = [error.what, error.where, error.remedy]
    except Exception as error:
        complaint = _in_words(error)
    else:
        np.savez(result, facts=np.frombuffer(json.dumps(facts).encode(), np.uint8), **arrays)
        return
    print(json.dumps(complaint))


def _in_words(error: Exception) -> str:
    """What a library says of a file, without its type and without where to report it."""
    message = (str(error).strip().splitlines() or [""])[0].split(", please")[0]
    if isinstance(error, MemoryError) or "bad_alloc" in message:
        return "it asks for more memory than a file of its size can need"
    return shown(message, 120) or type(error).__name__


def _size(path: Path) -> int:
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    return sum(file.stat().st_size for file in files)
