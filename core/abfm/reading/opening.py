"""Opening of files of any format: decompression and detection of the format.

The format is detected by the first bytes if it has a signature, else by the ending of the name. A
Git LFS pointer, a web page or an archive is refused with a message that names it.
"""

import os
import re
import struct
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from abfm.reading.regular_files import inflated, read_bytes


class Format(StrEnum):
    """Formats of files; the values complete the sentence "the file is ..."."""

    OBJ = "an OBJ mesh"
    OFF = "an OFF mesh"
    PLY = "a PLY mesh"
    STL = "an STL mesh"
    GLTF = "a glTF scene"
    GLB = "a binary glTF scene"
    MNI_OBJ = "an MNI object file"
    GIFTI = "a GIFTI file"
    CIFTI = "a CIFTI file"
    NIFTI = "a NIfTI image"
    VTK_LEGACY = "a legacy VTK file"
    VTK_XML = "a VTK XML file"
    COLLECTION = "a ParaView collection"
    SERIES = "a ParaView file series"
    FREESURFER_SURFACE = "a FreeSurfer surface"
    FREESURFER_QUADS = "a FreeSurfer surface of quadrangles"
    FREESURFER_ASCII = "a FreeSurfer text file"
    FREESURFER_VALUES = "a FreeSurfer file of values"
    FREESURFER_OLD_VALUES = "an old FreeSurfer file of values"
    ANNOTATION = "a FreeSurfer annotation"
    LABEL_LIST = "a FreeSurfer label file"
    MGH = "an MGH file"
    STC = "an MNE source estimate"
    NPY = "a NumPy array"
    NPZ = "a NumPy archive"
    MAT = "a MATLAB file"
    HDF5 = "an HDF5 file"
    TABLE = "a table"
    UNKNOWN = "of an unknown format"


class Opened(NamedTuple):
    """A file that was read: its path, its format, and its bytes after decompression."""

    path: Path
    format: Format
    data: bytes


ENDINGS = {
    ".obj": Format.OBJ,
    ".off": Format.OFF,
    ".ply": Format.PLY,
    ".stl": Format.STL,
    ".gltf": Format.GLTF,
    ".glb": Format.GLB,
    ".gii": Format.GIFTI,
    ".nii": Format.NIFTI,
    ".vtk": Format.VTK_LEGACY,
    ".vtp": Format.VTK_XML,
    ".vtu": Format.VTK_XML,
    ".pvd": Format.COLLECTION,
    ".series": Format.SERIES,
    ".asc": Format.FREESURFER_ASCII,
    ".srf": Format.FREESURFER_ASCII,
    ".annot": Format.ANNOTATION,
    ".label": Format.LABEL_LIST,
    ".mgh": Format.MGH,
    ".mgz": Format.MGH,
    ".stc": Format.STC,
    ".npy": Format.NPY,
    ".npz": Format.NPZ,
    ".mat": Format.MAT,
    **dict.fromkeys(
        (".csv", ".tsv", ".txt", ".dat", ".1d", ".1d.dset", ".vts", ".map"), Format.TABLE
    ),
}
"""The format of each ending of a name, in lower case and without ``.gz``."""
VALUES_ENDINGS = (
    *(".npy", ".npz", ".mat", ".csv", ".tsv", ".txt", ".1d", ".gii", ".gii.gz", ".mgh", ".mgz"),
    *(".dscalar.nii", ".dtseries.nii", ".nii", ".nii.gz", ".stc"),
    *(".vts", ".asc", ".vtk", ".vtp", ".vtu", ".ply"),
)
"""Endings of files with values at vertices; FreeSurfer files may have any other ending."""
FRAMES_ENDINGS = (*VALUES_ENDINGS, ".pvd", ".series")  # endings of names of files with frames
LABELS_ENDINGS = (".annot", ".label", ".dlabel.nii")
"""Endings of files with labels of vertices, in addition to those of values."""

_GZIP = b"\x1f\x8b"
_ZIP = b"PK\x03\x04"
_SIGNATURES = {
    b"\x93NUMPY": Format.NPY,
    b"ply\n": Format.PLY,
    b"ply\r": Format.PLY,
    b"glTF": Format.GLB,
    b"# vtk DataFile": Format.VTK_LEGACY,
    b"MATLAB 5.0": Format.MAT,
    b"MATLAB 7.3": Format.HDF5,
    b"\x89HDF\r\n\x1a\n": Format.HDF5,
    b"\xff\xff\xfe": Format.FREESURFER_SURFACE,
    b"\xff\xff\xfd": Format.FREESURFER_QUADS,
}
_ARCHIVES = {
    _ZIP: "a ZIP archive",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive",
    b"Rar!\x1a\x07": "a RAR archive",
    b"BZh": "a bzip2 archive",
    b"\xfd7zXZ\x00": "an xz archive",
    b"\x28\xb5\x2f\xfd": "a Zstandard archive",
}
_CONVERTIBLE_FORMATS = {
    b"\xff\xff\xff\xff": "a FreeSurfer patch, which has no triangles. Write it as a surface: "
    "mris_convert -p PATCH NAME.surf.gii",
    b"<AFNI_dataset": "an AFNI dataset. Write it as GIFTI: "
    "ConvertDset -o_gii -input DATASET -prefix NAME.gii",
}
_SPREADSHEETS = (".xlsx", ".xlsm", ".ods")
_TAR = b"ustar"
_TAR_OFFSET = 257
_OLD_OR_NEW_MAGIC = b"\xff\xff\xff"  # first bytes of old quadrangles, and also of new values
_HEAD_BYTES = 1 << 16
_ROOT = re.compile(r"<(GIFTI|VTKFile)\b([^>]*)")
_WEB_PAGE = re.compile(
    r"\s*(?:<\?xml[^>]*>\s*)?<(?:!doctype\s+html|html|head|body)\b", re.IGNORECASE
)
_MNI_OBJECT = re.compile(r"P(?:\s+[-+.0-9eE]+){5}\s+\d+\s")
_OFF_HEADER = re.compile(r"\s*+(?:#[^\n]*+\s*+)*+(?:ST|C|N){0,3}4?n?OFF(?:\s+BINARY)?\s*\d")
_TEXTS = {_MNI_OBJECT: Format.MNI_OBJ, _OFF_HEADER: Format.OFF}
_CIFTI_INTENTS = range(3000, 3100)


def open_file(path: str | os.PathLike[str]) -> Opened:
    """Read an uncompressed or gzip-compressed file and detect its format.

    Raises OSError if the file cannot be read, see `open_regular`. Raises ValueError if the file is
    empty, its compressed data are damaged, or it is a Git LFS pointer, a web page or an archive.
    """
    file = Path(os.path.expanduser(path))
    data, name = read_bytes(file), file.name.lower()
    if data.startswith(_GZIP):
        data, name = inflated(data), name.removesuffix(".gz")
    if not data:
        raise ValueError("the file is empty")
    head = decoded(data[:_HEAD_BYTES], "replace")
    _refuse_other_contents(data, head, name)
    return Opened(file, _format(data, head, name), data)


def decoded(data: bytes, errors: str = "strict") -> str:
    """Decode UTF-8 or UTF-16, detected by the byte order mark, and convert line ends to line feeds.

    UTF-16 without a mark is detected by its zero bytes. Other text raises a UnicodeDecodeError,
    unless ``errors`` is "replace".
    """
    encoding = "utf-8-sig"
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    elif data[1:4:2] == b"\0\0" and data[0] and data[2]:
        encoding = "utf-16-le"
    elif data[:4:2] == b"\0\0" and data[1:2] != b"\0" and data[3:4] not in (b"", b"\0"):
        encoding = "utf-16-be"
    return data.decode(encoding, errors).replace("\r\n", "\n").replace("\r", "\n")


def _refuse_other_contents(data: bytes, head: str, name: str) -> None:
    if head.startswith("version https://git-lfs"):
        raise ValueError(
            "the file is a Git LFS pointer, not the data itself. Fetch the data with: git lfs pull"
        )
    if _WEB_PAGE.match(head):
        raise ValueError("the file is a web page (HTML). Download the data file itself")
    if name.endswith(_SPREADSHEETS):
        raise ValueError("the file is a spreadsheet. Save the values as CSV")
    for mark, text in _CONVERTIBLE_FORMATS.items():
        if data.startswith(mark):
            raise ValueError(f"the file is {text}")
    archive = next((text for mark, text in _ARCHIVES.items() if data.startswith(mark)), None)
    if archive is None and data[_TAR_OFFSET : _TAR_OFFSET + len(_TAR)] == _TAR:
        archive = "a tar archive"
    if archive and not (data.startswith(_ZIP) and name.endswith(".npz")):
        raise ValueError(f"the file is {archive}. Unpack it and use a file in it")


def _format(data: bytes, head: str, name: str) -> Format:
    for mark, found in _SIGNATURES.items():
        if data.startswith(mark):
            return found
    if data.startswith(_OLD_OR_NEW_MAGIC):
        # the oldest surfaces have 16-bit coordinates, and 3-byte vertex numbers of quadrangles
        vertices, quads = (int.from_bytes(data[at : at + 3], "big") for at in (3, 6))
        has_quads = len(data) == 9 + 6 * vertices + 12 * quads
        return Format.FREESURFER_QUADS if has_quads else Format.FREESURFER_VALUES
    if root := _ROOT.search(head) if head.lstrip().startswith("<") else None:
        if root[1] == "GIFTI":
            return Format.GIFTI
        return Format.COLLECTION if "Collection" in root[2] else Format.VTK_XML
    if image := _nifti(data):
        return image
    ending = next((ending for ending in ENDINGS if name.endswith(ending)), "")
    # old FreeSurfer values are two 3-byte counts, then 16-bit values
    if not ending and 6 < len(data) == 6 + 2 * int.from_bytes(data[:3], "big"):
        return Format.FREESURFER_OLD_VALUES
    named = ENDINGS.get(ending, Format.UNKNOWN)
    if head.startswith("#!ascii") and named is not Format.LABEL_LIST:
        return Format.FREESURFER_ASCII
    by_text = (form for start, form in _TEXTS.items() if start.match(head))
    return named if named is Format.TABLE else next(by_text, named)


def _nifti(data: bytes) -> Format | None:
    for order in "<>":
        size = struct.unpack_from(f"{order}i", data)[0] if len(data) >= 4 else 0
        if size == 348 and data[344:347] in (b"n+1", b"ni1"):
            return Format.NIFTI
        if size == 540 and data[4:7] in (b"n+2", b"ni2"):
            intent = struct.unpack_from(f"{order}i", data, 504)[0] if len(data) >= 540 else 0
            return Format.CIFTI if intent in _CIFTI_INTENTS else Format.NIFTI
    return None
