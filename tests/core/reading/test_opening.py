"""Detection of file formats by contents, and errors for files without data."""

import gzip
import struct
from pathlib import Path

import pytest

from abfm.reading import Format, decoded, open_file

OFF = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"


def header_of_nifti(version: int, intent: int) -> bytes:
    if version == 1:
        return struct.pack("<i", 348) + bytes(340) + b"n+1\0"
    head = bytearray(struct.pack("<i", 540) + b"n+2\0\r\n\x1a\n" + bytes(528))
    head[504:508] = struct.pack("<i", intent)
    return bytes(head)


def old_quads(vertices: int, quads: int) -> bytes:
    counts = vertices.to_bytes(3, "big") + quads.to_bytes(3, "big")
    return b"\xff\xff\xff" + counts + bytes(6 * vertices + 12 * quads)


@pytest.mark.parametrize(
    ("name", "data", "expected"),
    [
        ("a.off", OFF, Format.OFF),
        ("a.off.gz", gzip.compress(OFF, mtime=0), Format.OFF),
        ("A.OBJ", b"v 0 0 0\n", Format.OBJ),
        ("wrong.obj", b"# a # b\nCOFF\n3 1 0\n", Format.OFF),
        ("without", OFF, Format.OFF),
        ("brain.obj", b"P 0.3 0.3 0.4 10 1 162\n -26.3 42.5 0\n", Format.MNI_OBJ),
        ("wrong.obj", b"ply\nformat ascii 1.0\n", Format.PLY),
        ("lh.white", b"\xff\xff\xfecreated by\n\n", Format.FREESURFER_SURFACE),
        ("lh.old", old_quads(4, 2), Format.FREESURFER_QUADS),
        ("lh.sulc", b"\xff\xff\xff" + struct.pack(">iiif", 1, 1, 1, 0.5), Format.FREESURFER_VALUES),
        ("lh.curv", (2).to_bytes(3, "big") + bytes(3) + bytes(4), Format.FREESURFER_OLD_VALUES),
        ("lh.small.asc", b"#!ascii version of lh.small\n3 1\n", Format.FREESURFER_ASCII),
        ("lh.V1.label", b"#!ascii label, from subject a\n0\n", Format.LABEL_LIST),
        (
            "a.func.gii",
            b"<?xml version='1.0'?>\n<!DOCTYPE GIFTI SYSTEM 'x'>\n<GIFTI>",
            Format.GIFTI,
        ),
        ("values.xml", b"<GIFTI Version='1.0'>", Format.GIFTI),
        ("a.vtu", b"<VTKFile type='UnstructuredGrid'>", Format.VTK_XML),
        ("a.pvd", b"<VTKFile type='Collection'>", Format.COLLECTION),
        ("a.dscalar.nii", header_of_nifti(2, 3006), Format.CIFTI),
        ("a.nii", header_of_nifti(2, 0), Format.NIFTI),
        ("a.nii.gz", gzip.compress(header_of_nifti(1, 0), mtime=0), Format.NIFTI),
        ("a.npz", b"PK\x03\x04", Format.NPZ),
        ("a.tsv", b"x\ty\n", Format.TABLE),
        ("a.1D.dset", b"# a\n0.5\n", Format.TABLE),
        ("a.xyz", b"0 0 0\n", Format.UNKNOWN),
    ],
)
def test_format_of_files_is_detected(
    tmp_path: Path, name: str, data: bytes, expected: Format
) -> None:
    """Signatures have priority over endings, also in compressed files."""
    path = tmp_path / name
    path.write_bytes(data)
    assert open_file(path).format is expected


def test_compressed_files_are_decompressed(tmp_path: Path) -> None:
    (tmp_path / "a.off.gz").write_bytes(gzip.compress(OFF, mtime=0))
    assert open_file(tmp_path / "a.off.gz").data == OFF


@pytest.mark.parametrize("name", ["a.obj", "a.gii", "lh.white", "a.npy", "a.csv"])
@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "empty"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "Git LFS"),
        (b"\n<!DOCTYPE html>\n<html>", "web page"),
        (b"<?xml version='1.0'?><html xmlns='x'>", "web page"),
        (b"PK\x03\x04rest", "ZIP archive"),
        (bytes(257) + b"ustar\x0000", "tar archive"),
        (b"\x1f\x8b\x08rest", "damaged"),
        (b"\xff\xff\xff\xff\0\0\0\1" + bytes(16), "patch"),
        (b"<AFNI_dataset self_idcode='x' >", "AFNI"),
    ],
)
def test_other_contents_are_named(tmp_path: Path, name: str, data: bytes, reason: str) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(ValueError, match=reason):
        open_file(path)


def test_spreadsheet_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.xlsx").write_bytes(b"PK\x03\x04rest")
    with pytest.raises(ValueError, match="spreadsheet"):
        open_file(tmp_path / "a.xlsx")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_text_encodings_are_detected(encoding: str) -> None:
    assert decoded("v 1 2\r\né\rx\n".encode(encoding)) == "v 1 2\né\nx\n"
