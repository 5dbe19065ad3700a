"""What all text readers share: decoding, separators, and single cells."""

import codecs
import math
import re
from pathlib import Path

from .._errors import InputError, at_line

MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
LARGEST = 1e100
_NOT_ASCII = re.compile(rb"[\w\x80-\xff]*[\x80-\xff][\w\x80-\xff]*")
_LETTER = re.compile(rb"[A-Za-z]")
# What Latin-1 and Windows agree on: the letters, and the signs of degree, square, cube and micro.
_LATIN = frozenset((*b"\xb0\xb2\xb3\xb5", *range(0xC0, 0x100))) - frozenset(b"\xd7\xf7")


def read_text(path: Path) -> str:
    """The text of a file, a byte-order mark dropped and line ends made plain.

    It is UTF-8 unless its byte-order mark, or every second byte being zero, says UTF-16; or unless it cannot be and
    all its other bytes are letters or signs of Latin-1 within words.

    **Raises:** `InputError` for a file that cannot be opened, whose encoding is not clear, or that is empty.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"Cannot read the file ({error.strerror})", str(path), "check its name and rights") from None
    text = decoded(raw, path)
    if not text.strip():
        raise InputError("The file is empty", at_line(path, 1), "export it again, or remove it from the case")
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError("The file is not text: it has a zero byte", at_line(path, line), "export it again as text")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def decoded(raw: bytes, path: Path) -> str:
    """`raw` as text. **Raises:** `InputError` where its encoding is not clear."""
    encoding = encoding_of(raw)
    try:
        return raw.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding == "utf-8" and all(_is_latin(word) for word in _NOT_ASCII.findall(raw)):
            return raw.decode("latin-1")
        line = raw.count(b"\n", 0, error.start) + 1
        name = encoding.upper().removesuffix("-SIG")
        raise InputError(f"The file is not {name}", at_line(path, line), "save it again as UTF-8 text") from None


def encoding_of(raw: bytes) -> str:
    """The encoding that the first bytes of a file speak for, UTF-8 where nothing else does."""
    for mark, encoding in MARKS:
        if raw.startswith(mark):
            return encoding
    head = raw[:400]
    if len(head) > 8 and not any(head[::2]):
        return "utf-16-be"
    if len(head) > 8 and not any(head[1::2]):
        return "utf-16-le"
    return "utf-8"


def _is_latin(word: bytes) -> bool:
    return bool(_LETTER.search(word)) and all(byte < 0x80 or byte in _LATIN for byte in word)


def separator_of(text: str) -> tuple[str, str]:
    """What divides the cells of a table, and its decimal mark: in a table divided by `;` a comma is one too."""
    head = text[:200_000]
    counts = {mark: head.count(mark) for mark in ",;\t"}
    if counts["\t"] > max(counts[","] // 2, counts[";"]):
        # With tabs, commas are decimal marks wherever one stands between two digits.
        return "\t", "," if re.search(r"[\t\n]-?\d+,\d", head) else "."
    return (";", ",") if counts[";"] > counts[","] // 2 else (",", ".")


def split(line: str, separator: str) -> list[str]:
    """The cells of a line, without spaces or quotes around them."""
    return [cell.strip(' \t"') for cell in line.split(separator)]


def is_blank(line: str) -> bool:
    """Whether no cell of the line holds anything."""
    return not line.strip(' \t,;"')


def number(cell: str, name: str, where: str, decimal: str = ".") -> float:
    """The finite number in a cell, or NaN for a blank one.

    **Raises:** `InputError` for anything else, "nan" and "inf" among it, and numbers that no recording can hold.
    """
    if not cell:
        return math.nan
    try:
        value = float(cell.replace(decimal, ".").replace("_", "?"))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        remedy = "write a finite number, or leave the cells of a lost frame blank"
        raise InputError(f'"{shown(cell)}" for {shown(name)} is not a finite number', where, remedy)
    if abs(value) > LARGEST:
        raise InputError(f'"{shown(cell)}" for {shown(name)} is too large', where, "correct it, or leave it blank")
    return value


def shown(text: str, length: int = 40) -> str:
    """`text` cut short for a complaint."""
    return text if len(text) <= length else f"{text[:length]}..."
