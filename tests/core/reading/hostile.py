"""Files that announce more data than they have, and checks of the errors for them."""

import io
import zipfile
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abfm.errors import ResultError


def npy(header, data=b"", version=1):
    content = header.ljust(117).encode() + b"\n"
    length = len(content).to_bytes(2 if version == 1 else 4, "little")
    return b"\x93NUMPY" + bytes([version, 0]) + length + content + data


def npy_of(shape, descr="<f8", data=b""):
    """Return a .npy file whose header has this shape and type."""
    return npy(f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}", data)


def gifti(text, dims='Dimensionality="1" Dim0="3"', encoding="ASCII", more=""):
    return (
        '<?xml version="1.0"?><GIFTI Version="1.0" NumberOfDataArrays="1"><DataArray '
        'Intent="NIFTI_INTENT_SHAPE" DataType="NIFTI_TYPE_FLOAT32" Endian="LittleEndian" '
        f'ArrayIndexingOrder="RowMajorOrder" {dims} Encoding="{encoding}" {more}>'
        f"<Data>{text}</Data></DataArray></GIFTI>"
    ).encode()


def bomb(size):
    """Return zeros compressed by zlib to a thousandth of their size."""
    packer, zeros = zlib.compressobj(1), bytes(1 << 20)
    return b"".join(packer.compress(zeros) for _ in range(size >> 20)) + packer.flush()


def overlapping_zip(path, names, content):
    """Write a zip whose members overlap, so that they are much larger than the file."""
    found = []
    for name in reversed(names):
        member = zipfile.ZipInfo(name)
        member.file_size = member.compress_size = len(content)
        member.CRC = zlib.crc32(content)
        content = member.FileHeader() + content
        found.append((member, len(content)))
    with zipfile.ZipFile(path, "w") as archive:
        archive.fp.write(content)
        archive.start_dir = len(content)
        for member, length in found:
            member.header_offset = len(content) - length
            archive.filelist.append(member)
        archive.comment = b"written"


def zipped(members, compression=zipfile.ZIP_STORED):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name), data, compression)
    return content.getvalue()


def members(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def rewrite(path, changes, compression=zipfile.ZIP_STORED):
    """Write a zip again with other members, arrays or bytes; None removes a member."""
    content = members(path) | changes
    for name, value in changes.items():
        if isinstance(value, np.ndarray | np.generic):
            file = io.BytesIO()
            np.save(file, value)
            content[name] = file.getvalue()
    kept = {name: data for name, data in content.items() if data is not None}
    path.write_bytes(zipped(kept, compression))


def refusal(load, path):
    """Return the error message of loading a result or project: a short line with the path."""
    with pytest.raises(ResultError) as caught:
        load(path)
    return message_of(caught.value, path)


def message_of(error, path):
    message = str(error)
    assert message.isprintable()
    assert len(message) <= 600
    assert str(path) in message
    return message


def one_byte_changed(content, places):
    """Yield a copy of the content for each of the given positions, with the byte there changed."""
    for place in places:
        changed = bytearray(content)
        changed[place] ^= (0x01, 0x20, 0x80)[place % 3]
        yield bytes(changed)


def with_flipped_bits(path, load, check):
    """Load a file with one changed byte: it must be refused, or have the original contents."""
    content_before = path.read_bytes()

    @settings(max_examples=150, derandomize=True)
    @given(position=st.integers(0, len(content_before) - 1), value=st.integers(1, 255))
    def flip(position, value):
        content = bytearray(content_before)
        content[position] ^= value
        path.write_bytes(content)
        load_or_refuse(path, load, check)

    flip()


def load_or_refuse(path, load, check):
    """Load a file and check the result, unless the file is refused by a message of one line."""
    try:
        loaded = load(path)
    except ResultError as error:
        message = str(error)
        assert message.isprintable()
    else:
        check(loaded)
