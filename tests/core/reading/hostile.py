"""Makers of files that say they hold more than there is, and what their refusal must be like."""

import io
import zipfile
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abfm.errors import ResultError


def npy(header, data=b"", version=1):
    """An array file with a header of our own."""
    content = header.ljust(117).encode() + b"\n"
    length = len(content).to_bytes(2 if version == 1 else 4, "little")
    return b"\x93NUMPY" + bytes([version, 0]) + length + content + data


def npy_of(shape, descr="<f8", data=b""):
    """An array file whose header gives a shape and a type."""
    return npy(f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}", data)


def gifti(text, dims='Dimensionality="1" Dim0="3"', encoding="ASCII", more=""):
    """A GIFTI file of one array of 32 bit floats."""
    return (
        '<?xml version="1.0"?><GIFTI Version="1.0" NumberOfDataArrays="1"><DataArray '
        'Intent="NIFTI_INTENT_SHAPE" DataType="NIFTI_TYPE_FLOAT32" Endian="LittleEndian" '
        f'ArrayIndexingOrder="RowMajorOrder" {dims} Encoding="{encoding}" {more}>'
        f"<Data>{text}</Data></DataArray></GIFTI>"
    ).encode()


def bomb(size):
    """So many zeros in a thousandth of their size, by zlib."""
    packer, zeros = zlib.compressobj(1), bytes(1 << 20)
    return b"".join(packer.compress(zeros) for _ in range(size >> 20)) + packer.flush()


def overlapping_zip(path, names, content):
    """A zip each of whose members holds the next one: together much more than the file."""
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
    """A zip of some members."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name), data, compression)
    return content.getvalue()


def members(path):
    """What a zip has: the content of each member by its name."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def rewrite(path, changes, compression=zipfile.ZIP_STORED):
    """Write a zip anew with other members, arrays or bytes; None leaves one out."""
    content = members(path) | changes
    for name, value in changes.items():
        if isinstance(value, np.ndarray | np.generic):
            file = io.BytesIO()
            np.save(file, value)
            content[name] = file.getvalue()
    kept = {name: data for name, data in content.items() if data is not None}
    path.write_bytes(zipped(kept, compression))


def refusal(load, path):
    """Why a result or project cannot be loaded: one bounded line that names the file."""
    with pytest.raises(ResultError) as caught:
        load(path)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) <= 600
    assert str(path) in message
    return message


def one_byte_changed(content, places):
    """The content with one of its bytes changed, for each of some places."""
    for place in places:
        changed = bytearray(content)
        changed[place] ^= (0x01, 0x20, 0x80)[place % 3]
        yield bytes(changed)


def with_flipped_bits(path, load, check):
    """Load a file with a byte changed: it is refused in one line, or comes as it was."""
    whole = path.read_bytes()

    @settings(deadline=None, max_examples=150, derandomize=True)
    @given(position=st.integers(0, len(whole) - 1), value=st.integers(1, 255))
    def flip(position, value):
        content = bytearray(whole)
        content[position] ^= value
        path.write_bytes(content)
        load_or_refuse(path, load, check)

    flip()


def load_or_refuse(path, load, check):
    """Check what is loaded, unless it is refused in one line."""
    try:
        loaded = load(path)
    except ResultError as error:
        message = str(error)
        assert message.isprintable()
    else:
        check(loaded)
