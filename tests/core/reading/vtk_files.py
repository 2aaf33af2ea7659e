"""Independent writer of VTK XML files in all forms of ParaView."""

import base64
import lzma
import zlib

import numpy as np

from abfm.reading import open_file, vtk_contents

COMPRESSORS = {
    "": None,
    "vtkZLibDataCompressor": zlib.compress,
    "vtkLZMADataCompressor": lzma.compress,
}
_BLOCK = 64  # bytes, so that small arrays have several blocks


def _packed(values, order, head, compress):
    """Return the header and the bytes of an array."""
    data = values.astype(values.dtype.newbyteorder(order)).tobytes()
    kind = np.dtype(order + head)
    if compress is None:
        return np.array([len(data)], kind).tobytes(), data
    blocks = [data[k : k + _BLOCK] for k in range(0, len(data), _BLOCK)]
    packs = [compress(block) for block in blocks]
    numbers = [len(blocks), _BLOCK, len(data) % _BLOCK, *map(len, packs)]
    return np.array(numbers, kind).tobytes(), b"".join(packs)


def vtk_bytes(
    points,
    data,
    form="raw",
    compressor="",
    head="u4",
    order="<",
    kind="UnstructuredGrid",
    together=False,
    time=None,
):
    """Return a file of points and point data; ``form`` is ascii, binary, base64 or raw."""
    appended, texts = b"", []

    def declared(name, values):
        nonlocal appended
        kinds = {"f": "Float", "i": "Int", "u": "UInt"}
        attributes = f'type="{kinds[values.dtype.kind]}{8 * values.dtype.itemsize}" Name="{name}"'
        if values.ndim > 1:
            attributes += f' NumberOfComponents="{values.shape[1]}"'
        if form == "ascii":
            words = " ".join(map(repr, values.ravel().tolist()))
            return f'<DataArray {attributes} format="ascii">\n{words}\n</DataArray>'
        header, body = _packed(values, order, head, COMPRESSORS[compressor])
        parts = [header + body] if together else [header, body]
        encoded = b"".join(parts if form == "raw" else map(base64.b64encode, parts))
        if form == "binary":
            more = '<InformationKey name="RANGE"><Value index="0">7</Value></InformationKey>'
            text = f"\n  {encoded.decode()}\n  {more}"
            return f'<DataArray {attributes} format="binary">{text}</DataArray>'
        begin, appended = len(appended), appended + encoded
        return f'<DataArray {attributes} format="appended" offset="{begin}"/>'

    if time is not None:
        texts += ["<FieldData>", declared("TimeValue", np.array([time])), "</FieldData>"]
    texts += [f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="0"><PointData>']
    texts += [declared(name, values) for name, values in data.items()]
    texts += ["</PointData><Points>", declared("Points", points), "</Points></Piece>"]
    order_word = {"<": "LittleEndian", ">": "BigEndian"}[order]
    head_word = {"u4": "UInt32", "u8": "UInt64"}[head]
    how = f' compressor="{compressor}"' if compressor else ""
    begin = (
        f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="1.0" byte_order="{order_word}" '
        f'header_type="{head_word}"{how}>\n<{kind}>{"".join(texts)}</{kind}>\n'
    )
    encoding = "raw" if form == "raw" else "base64"
    end = b"</VTKFile>\n"
    if form in ("raw", "base64"):
        tag = f'<AppendedData encoding="{encoding}">\n   _'.encode()
        end = tag + appended + b"\n  </AppendedData>\n" + end
    return begin.encode() + end


def point_data(path, name):
    return vtk_contents(open_file(path)).point_data[name]
