"""In which encoding a text file was written: what instruments and spreadsheets of many countries leave behind."""

from cellcal.service.engineering.measured.headings import heading_words

_LOOKED_AT = 200_000  # bytes, where the encoding is not plain
_EAST = ("gb18030", "cp932", "big5", "cp949")
_EUROPE = (  # encodings of one byte, and parts of headings that only they make
    ("cp1251", ("ось", "сустав", "шарнир", "точка", "измер", "задан", "номинал", "координат", "град")),
    ("cp866", ("ось", "сустав", "шарнир", "точка", "измер", "задан", "номинал", "координат", "град")),
    ("koi8_r", ("ось", "сустав", "шарнир", "точка", "измер", "задан", "номинал", "координат", "град")),
    ("cp1250", ("oś", "złącz", "współrz", "měřen", "souřad")),
)
_PLAIN_HANZI = range(0xB0, 0xD8)  # first byte of the common characters of GB 2312
_GB_MARKS = range(0xA1, 0xA4)  # of its punctuation
_BOMS = ((b"\xff\xfe\x00\x00", "utf-32"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))

_MARK_AS_TEXT = "\u00ef\u00bb\u00bf"  # that of UTF-8, read byte by byte


def text_of_table(data: bytes) -> str:
    """Return the text of a file. Marks of byte order are no text, wherever files were put together."""
    text = data.decode(encoding_of(data), errors="replace")
    return text.replace("\ufeff", "").replace(_MARK_AS_TEXT, "")


def encoding_of(data: bytes) -> str:
    """Return the encoding of a text file's bytes; what cannot be told is Western European."""
    for mark, name in _BOMS:
        if data.startswith(mark):
            return name
    for order, high_bytes in (("utf-16-le", data[1:400:2]), ("utf-16-be", data[:400:2])):
        if high_bytes.count(0) > len(high_bytes) // 2:
            return order
    try:
        data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return _of_a_country(data[:_LOOKED_AT])
    return "utf-8-sig"


def _of_a_country(data: bytes) -> str:
    lines = data.splitlines()
    high = b"\n".join(line for line in lines if any(byte > 0x7F for byte in line))
    words = heading_words()
    for name in _EAST:
        try:
            text = high.decode(name)
        except UnicodeDecodeError:
            continue
        if any(word in text for word in words):
            return name
    for name, parts in _EUROPE:
        text = high.decode(name, errors="replace").lower()
        if any(part in text for part in parts):
            return name
    return "gb18030" if _looks_like_gb(high) else "cp1252"


def _looks_like_gb(high: bytes) -> bool:
    """Return whether the bytes above ASCII come in pairs that are common Chinese characters."""
    runs = bytes(byte if byte > 0x7F else 0x20 for byte in high).split()
    pairs = [(run[at], run[at + 1]) for run in runs if len(run) % 2 == 0 for at in range(0, len(run), 2)]
    if not runs or any(len(run) % 2 for run in runs):
        return False
    common = sum(first in _PLAIN_HANZI or first in _GB_MARKS for first, _ in pairs)
    return all(second >= 0xA1 for _, second in pairs) and common >= 0.8 * len(pairs)
