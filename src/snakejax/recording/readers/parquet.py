"""Plain tables as Parquet, by pyarrow (extra `parquet`)."""

from pathlib import Path
from typing import Any

import numpy as np

from snakejax.core.errors import InputError

from .capture import MOST_COLUMNS, Capture, Source
from .columns import COUNTED, capture_of, columns_of
from .subprocess_reader import read_in_subprocess

MAGIC = b"PAR1"


def recognises(source: Source) -> bool:
    """Whether the file begins with the format's key."""
    return source.head.startswith(MAGIC)


def read(source: Source) -> Capture:
    """All objects. **Raises:** `InputError`."""
    facts, arrays = read_in_subprocess("parquet", source.path, "pyarrow")
    names, where = facts["names"], str(source.path)
    columns = columns_of(names, ["s" if i in facts["stamps"] else "" for i in range(len(names))], source.hints, where)
    values, labels = {}, None
    for column in columns:
        if column.column_index == COUNTED:
            continue
        if column.role == "object":
            labels = arrays.get(f"text {column.column_index}")
        else:
            values[column.column_index] = arrays.get(f"number {column.column_index}")
        if (labels if column.role == "object" else values[column.column_index]) is None:
            kind = "text" if column.role == "object" else "numbers"
            raise InputError(
                f"The column {names[column.column_index]} does not hold {kind}", where, "map another column"
            )
    return capture_of("Parquet", source, where, names, columns, values, labels)


def load(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The names of the columns, which of them are time stamps, and their values; blank is NaN, stamps are seconds."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(path)
    names = file.schema_arrow.names
    if len(names) > MOST_COLUMNS:
        raise InputError(f"The table has {len(names)} columns", str(path), f"keep at most {MOST_COLUMNS}")
    table = file.read()
    arrays, stamps = {}, []
    for i, column in enumerate(table.columns):
        kind = column.type
        if pa.types.is_timestamp(kind):
            nanoseconds = column.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64())
            arrays[f"number {i}"] = nanoseconds.cast(pa.float64(), safe=False).to_numpy() * 1e-9
            stamps.append(i)
        elif pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
            values = column.cast(pa.float64(), safe=False).to_numpy()
            if np.isinf(values).any():
                raise InputError(f"The column {names[i]} has an infinite value", str(path), "leave lost samples blank")
            arrays[f"number {i}"] = values
        elif pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_dictionary(kind):
            arrays[f"text {i}"] = np.array([str(value) for value in column.to_pylist()])
    return {"names": names, "stamps": stamps}, arrays
