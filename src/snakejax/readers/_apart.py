"""Reading by a library of another language in a process of its own, so that a damaged file can only end that one.

The library may crash, hang, or ask for any amount of memory; the user is told in one line.
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

from .._errors import InputError
from ._text import shown

MEMORY = 1 << 30
MEMORY_A_BYTE = 24
SECONDS = 9.0
BYTES_A_SECOND = 1e6
_CHILD = "from snakejax.readers._apart import child; child()"


def read_apart(module: str, path: Path, library: str, extra: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What `load(path)` of the reader `module` returns: facts that JSON can hold, and arrays by name.

    **Raises:** `InputError` where `library` is not installed, or cannot read the file.
    """
    if importlib.util.find_spec(library) is None:
        remedy = f'install it with pip install "snakejax[{extra}]"'
        raise InputError(f"Reading this format needs the library {library}", str(path), remedy)
    size = _size(path)
    seconds = SECONDS + size / BYTES_A_SECOND
    remedy = "export it again; it may be damaged"
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "found.npz"
        command = [sys.executable, "-c", _CHILD, module, str(path), str(found), str(MEMORY + MEMORY_A_BYTE * size)]
        paths = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
        environment = {**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        try:
            done = subprocess.run(command, env=environment, capture_output=True, timeout=seconds, check=False)
        except subprocess.TimeoutExpired:
            what = f"{library} did not finish reading it within {seconds:.0f} s"
            raise InputError(what, str(path), remedy) from None
        if done.returncode:
            raise InputError(f"{library} crashed on it", str(path), remedy)
        if not found.is_file():
            raise InputError(*json.loads(done.stdout.decode().splitlines()[-1]))
        with np.load(found, allow_pickle=False) as saved:
            arrays = {name: saved[name] for name in saved.files}
    return json.loads(arrays.pop("facts").tobytes()), arrays


def child() -> None:
    """What the other process does: `load` the file and save what it found, or print the complaint."""
    _, module, path, found, memory = sys.argv
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (int(memory), int(memory)))
    except (ImportError, ValueError, OSError):
        pass  # Not all systems limit memory; the time is limited everywhere.
    try:
        facts, arrays = importlib.import_module(f"snakejax.readers.{module}").load(Path(path))
    except InputError as error:
        complaint = [error.what, error.where, error.remedy]
    except MemoryError:
        complaint = ["It asks for more memory than a file of its size can need", path, "export it again"]
    except Exception as error:
        first = shown((str(error).strip().splitlines() or [""])[0], 120)
        complaint = [f"It cannot be read ({type(error).__name__}: {first})", path, "export it again"]
    else:
        np.savez(found, facts=np.frombuffer(json.dumps(facts).encode(), np.uint8), **arrays)
        return
    print(json.dumps(complaint))


def _size(path: Path) -> int:
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    return sum(file.stat().st_size for file in files)
