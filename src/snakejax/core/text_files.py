"""Reading of text files in UTF-8, UTF-16, UTF-32 and Latin-1."""

import codecs
import re
from pathlib import Path

from .errors import InputError, at_line

MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
LARGEST = 1e100
"""Largest magnitude of a number in a file: far above any measurement, and its square is finite."""
_NOT_ASCII = re.compile(rb"[\w\x80-\xff]*[\x80-\xff][\w\x80-\xff]*")
_LETTER = re.compile(rb"[A-Za-z]")
# Bytes with the same meaning in Latin-1 and Windows-1252: letters, and the signs of degree, square, cube and micro.
_LATIN = frozenset((*b"\xb0\xb2\xb3\xb5", *range(0xC0, 0x100))) - frozenset(b"\xd7\xf7")


def read_text(path: Path) -> str:
    """The text of a file without byte-order mark, with line ends converted to "\\n".

    The encoding is UTF-8 unless a byte-order mark shows another one, or every second byte is zero (UTF-16), or the file
    is not valid UTF-8 and all its other bytes are Latin-1 letters or signs within words.

    **Raises:** `InputError` if the file cannot be opened, its encoding is not clear, or it is empty.
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
    """`raw` as text. **Raises:** `InputError` if its encoding is not clear."""
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
    """The encoding by byte-order mark or zero bytes at the start of a file; UTF-8 by default."""
    for mark, encoding in MARKS:
        if raw.startswith(mark):
            return encoding
    start = raw[:400]
    if len(start) > 8 and not any(start[::2]):
        return "utf-16-be"
    if len(start) > 8 and not any(start[1::2]):
        return "utf-16-le"
    return "utf-8"


def _is_latin(word: bytes) -> bool:
    return bool(_LETTER.search(word)) and all(byte < 0x80 or byte in _LATIN for byte in word)
