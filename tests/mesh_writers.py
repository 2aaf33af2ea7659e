"""Writers of mesh files for tests, independent of the readers."""

import gzip
import struct

import nibabel
import numpy as np
import trimesh


def obj_text(vertices, faces):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    return "\n".join(lines + [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]) + "\n"


def off_text(vertices, faces):
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    return "\n".join(lines + [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]) + "\n"


def mni_obj(mesh, colors=0):
    """Return an MNI object file with one colour (``colors`` 0), one per face (1) or vertex (2)."""
    points = "\n".join(" ".join(map(repr, row)) for row in mesh.vertices.tolist())
    V, F = len(mesh.vertices), len(mesh.faces)
    some = "\n".join(["1 1 1 1"] * (1, F, V)[colors])
    ends = " ".join(str(3 * k) for k in range(1, F + 1))
    corners = " ".join(map(str, mesh.faces.ravel().tolist()))
    head = f"P 0.3 0.3 0.4 10 1 {V}\n{points}\n\n{points}\n\n{F}\n{colors} {some}\n"
    return f"{head}\n{ends}\n\n{corners}\n"


def ply_bytes(vertices, faces, kind="ascii"):
    header = (
        f"ply\nformat {kind} 1.0\ncomment made for a test\nelement vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\nproperty uchar red\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nproperty float "
        "quality\nend_header\n"
    ).encode()
    if kind == "ascii":
        rows = [f"{x!r} {y!r} {z!r} 255" for x, y, z in vertices.tolist()]
        rows += [" ".join(map(str, [len(face), *face, 0.5])) for face in faces]
        return header + "\n".join(rows).encode()
    order = ">" if "big" in kind else "<"
    rows = [struct.pack(f"{order}dddB", *row, 255) for row in vertices.tolist()]
    rows += [struct.pack(f"{order}B{len(f)}if", len(f), *f, 0.5) for f in faces]
    return header + b"".join(rows)


def gifti_bytes(vertices, faces):
    arrays = [
        nibabel.gifti.GiftiDataArray(vertices.astype(np.float32), intent="NIFTI_INTENT_POINTSET"),
        nibabel.gifti.GiftiDataArray(faces.astype(np.int32), intent="NIFTI_INTENT_TRIANGLE"),
    ]
    return nibabel.gifti.GiftiImage(darrays=arrays).to_bytes()


def freesurfer_bytes(vertices, faces):
    counts = struct.pack(">ii", len(vertices), len(faces))
    arrays = vertices.astype(">f4").tobytes() + faces.astype(">i4").tobytes()
    return b"\xff\xff\xfemade for a test\n\n" + counts + arrays + b"\0\0\0\x02tag"


def exported(vertices, faces, kind):
    data = trimesh.Trimesh(vertices, faces, process=False).export(file_type=kind)
    return data.encode() if isinstance(data, str) else data


WRITERS = {  # writer and relative precision by file name
    "a.obj": (lambda v, f: obj_text(v, f).encode(), 0),
    "a.off": (lambda v, f: off_text(v, f).encode(), 0),
    "ascii.ply": (lambda v, f: ply_bytes(v, f.tolist()), 0),
    "little.ply": (lambda v, f: ply_bytes(v, f.tolist(), "binary_little_endian"), 0),
    "big.ply": (lambda v, f: ply_bytes(v, f.tolist(), "binary_big_endian"), 0),
    "trimesh.ply": (lambda v, f: exported(v, f, "ply"), 1e-7),
    "trimesh.obj": (lambda v, f: exported(v, f, "obj"), 1e-7),
    "trimesh.off": (lambda v, f: exported(v, f, "off"), 1e-7),
    "a.glb": (lambda v, f: exported(v, f, "glb"), 1e-7),
    "a.surf.gii": (gifti_bytes, 1e-7),
    "a.gii.gz": (lambda v, f: gzip.compress(gifti_bytes(v, f)), 1e-7),
    "lh.white": (freesurfer_bytes, 1e-7),
    "rh.sphere.reg": (freesurfer_bytes, 1e-7),
}
STL_WRITERS = {"binary.stl": "stl", "ascii.stl": "stl_ascii"}


def off_file(path, mesh):
    return write(path.parent, path.name, off_text(mesh.vertices, mesh.faces))


def write(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path
