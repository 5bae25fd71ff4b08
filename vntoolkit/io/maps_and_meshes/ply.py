"""Stanford PLY: vertices with normals, colour and texture coordinates, and faces; ASCII and binary."""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import Array, ByteArray, Faces, FloatArray
from vntoolkit.errors import BadMesh
from vntoolkit.geometry.mesh import triangles_from_polygons
from vntoolkit.io.atomic import aligned_memory, write_large
from vntoolkit.io.files import opened, require_vertices

_KINDS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}
_FACE = np.dtype([("count", "u1"), ("corners", "V12")])
_LONGEST_HEADER = 1 << 16
_MOST_BYTES_OF_A_NUMBER = 32
_MOST_BYTES_OF_A_LIST = 1 << 12  # a polygon of hundreds of corners


@dataclass(frozen=True, kw_only=True, eq=False)
class PlyContent:
    """What a PLY file holds, in the frame of the file.

    vertices: (n, 3). faces: (m, 3) int32 or None for a point cloud. normals: (n, 3). colours: (n, 3) uint8.
    uv: (n, 2). quality: (n,) float, MeshLab's name for one number a vertex.
    """

    vertices: FloatArray
    faces: Faces | None = None
    normals: FloatArray | None = None
    colours: ByteArray | None = None
    uv: FloatArray | None = None
    quality: FloatArray | None = None


def write_ply(
    path: Path | str, content: PlyContent, comment: str = "x right, y up, z towards the viewer"
) -> None:
    """Write little-endian binary: float32 `x y z nx ny nz s t quality`, uchar `red green blue`, triangles."""
    columns: list[tuple[str, str, Array | None]] = [
        ("x y z", "<f4", content.vertices),
        ("nx ny nz", "<f4", content.normals),
        ("s t", "<f4", content.uv),
        ("quality", "<f4", content.quality),
        ("red green blue", "u1", content.colours),
    ]
    # Each column as bytes: of fields at odd addresses numpy copies numbers five times as slowly.
    parts = {
        names: np.ascontiguousarray(values, kind).view(f"V{np.dtype(kind).itemsize * len(names.split())}")
        for names, kind, values in columns
        if values is not None
    }
    header = ["ply", "format binary_little_endian 1.0", f"comment {comment}"]
    header.append(f"element vertex {len(content.vertices)}")
    for names, kind, _ in columns:
        if names in parts:
            header += [f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name in names.split()]
    faces = np.empty((0, 3), np.int32) if content.faces is None else content.faces
    if content.faces is not None:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    head = "\n".join([*header, "end_header\n"]).encode("ascii")
    row = np.dtype([(names, values.dtype) for names, values in parts.items()])
    end = len(head) + row.itemsize * len(content.vertices)
    memory = aligned_memory(end + _FACE.itemsize * len(faces))
    memory[: len(head)] = np.frombuffer(head, np.uint8)
    vertices, triangles = memory[len(head) : end].view(row), memory[end:].view(_FACE)
    for names, values in parts.items():
        vertices[names] = values.reshape(-1)
    triangles["count"] = 3
    triangles["corners"] = np.ascontiguousarray(faces, "<i4").view("V12").reshape(-1)
    write_large(path, memory.data)


def read_ply(path: Path | str) -> PlyContent:
    """Read a PLY file; raise `BadMesh` with one line for a malformed one."""
    with opened(path, BadMesh) as stream:
        data = stream.read(_LONGEST_HEADER)
        size = os.fstat(stream.fileno()).st_size
        order, elements, at = parse_ply_header(data, str(path), size)
        if size > _LONGEST_HEADER + sum(element.most_bytes for element in elements):
            raise BadMesh(f"{path}: {size / 1e6:.0f} MB are more than the rows that its header promises take")
        data += stream.read()
    tables: dict[str, Any] = {}
    try:
        lines = iter(data[at:].splitlines()) if order == "ascii" else iter(())
        for element in elements:
            if order == "ascii":
                tables[element.name] = _ascii_table(element, lines)
            else:
                tables[element.name], at = _binary_table(element, data, at, order)
    except (ValueError, IndexError, StopIteration) as problem:
        reason = str(problem) or "too few lines"
        raise BadMesh(f"{path}: the element '{element.name}' is malformed or cut off ({reason})") from problem
    columns = tables.get("vertex", {}).items()
    vertex = {key: values for key, values in columns if isinstance(values, np.ndarray) and values.ndim == 1}
    if not {"x", "y", "z"} <= set(vertex):
        raise BadMesh(f"{path}: expected an element 'vertex' with x, y and z")
    return _content(str(path), vertex, tables.get("face"))


def _content(name: str, vertex: dict[str, Any], face: dict[str, Any] | None) -> PlyContent:
    def gather(*names: str) -> Array | None:
        return np.stack([vertex[n] for n in names], axis=1) if set(names) <= set(vertex) else None

    def gather_floats(*names: str) -> FloatArray | None:
        values = gather(*names)
        whole = values is not None and not np.issubdtype(values.dtype, np.floating)
        return values.astype(np.float64) if values is not None and whole else values

    vertices, normals = gather_floats("x", "y", "z"), gather_floats("nx", "ny", "nz")
    assert vertices is not None
    pairs = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
    uv = next((found for pair in pairs if (found := gather_floats(*pair)) is not None), None)
    colours = gather("red", "green", "blue")
    for what, values in (("vertex", vertices), ("normal", normals), ("colour", colours), ("uv", uv)):
        if values is not None and not np.isfinite(values).all():
            raise BadMesh(f"{name}: a {what} is NaN or infinite")
    faces = None
    if face is not None:
        polygons = face.get("vertex_indices", face.get("vertex_index"))
        if polygons is None or (isinstance(polygons, np.ndarray) and polygons.ndim == 1):
            raise BadMesh(f"{name}: the faces have no list 'vertex_indices'")
        faces = triangles_from_polygons(polygons, len(vertices), name)
    quality = gather_floats("quality")
    return PlyContent(
        vertices=vertices,
        faces=faces,
        normals=normals,
        colours=bytes_from_colours(colours),
        uv=uv,
        quality=None if quality is None or not np.isfinite(quality).all() else quality[:, 0],
    )


def bytes_from_colours(colours: Array | None) -> ByteArray | None:
    """Return colours (n, 3) as bytes: floats count from 0 to 1, 16 bits to 65535, other integers to 255."""
    if colours is None or colours.dtype == np.uint8:
        return colours
    is_float, is_short = np.issubdtype(colours.dtype, np.floating), colours.dtype == np.uint16
    full = 1.0 if is_float else 65535.0 if is_short else 255.0
    return np.rint(np.clip(colours * (255.0 / full), 0, 255)).astype(np.uint8)


def _binary_table(element: "PlyElement", data: bytes, at: int, order: str) -> tuple[dict[str, Any], int]:
    """Read one element; one whose lists are all as long as those of its first row takes the fast way."""
    end = at

    def take(kind: str, count: int) -> Array:
        nonlocal end
        size = count * np.dtype(kind).itemsize
        require_bytes(data, end, size)
        end += size
        return np.frombuffer(data, order + kind, count, end - size)

    first = _rows(element, repeat(take, min(1, element.count)))
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    lengths = {}
    for p in element.properties:
        if p.count_kind:
            lengths[p.name] = len(first[p.name][0]) if element.count else 0
            fields.append(("\0" + p.name, order + p.count_kind, ()))
        fields.append((p.name, order + p.kind, (lengths[p.name],) if p.count_kind else ()))
    row = np.dtype(fields)
    if not lengths:
        require_bytes(data, at, element.count * row.itemsize)
    if element.count * row.itemsize <= len(data) - at:
        table = np.frombuffer(data, row, element.count, at)
        if all((table["\0" + name] == length).all() for name, length in lengths.items()):
            return {p.name: table[p.name].astype(p.kind) for p in element.properties}, at + table.nbytes
    end = at
    return _rows(element, repeat(take, element.count)), end


def _ascii_table(element: "PlyElement", lines: Any) -> dict[str, Any]:
    text = [next(lines) for _ in range(element.count)]
    if element.count and not element.has_list:
        values = np.loadtxt(text, ndmin=2)
        return {p.name: _of_kind(values[:, i], p.kind) for i, p in enumerate(element.properties)}

    def take_from(line: bytes) -> Callable[[str, int], Array]:
        words = iter(line.split())
        return lambda kind, count: _of_kind([float(next(words)) for _ in range(count)], kind)

    return _rows(element, map(take_from, text))


def _rows(element: "PlyElement", takes: Iterable[Callable[[str, int], Array]]) -> dict[str, Any]:
    """Read rows one by one. takes: of each row, what returns its next numbers of a kind, so many."""
    table: dict[str, list[Array]] = {p.name: [] for p in element.properties}
    for take in takes:
        for p in element.properties:
            length = int(take(p.count_kind, 1)[0]) if p.count_kind else 1
            if length < 0:
                raise ValueError("a list of negative length")
            table[p.name].append(take(p.kind, length))
    return {
        p.name: table[p.name] if p.count_kind else np.concatenate(table[p.name] or [np.empty(0)])
        for p in element.properties
    }


def _of_kind(values: Any, kind: str) -> Array:
    """Numbers of a text as a PLY kind; NaN and what exceeds an integer raise instead of wrapping round."""
    numbers = np.asarray(values, dtype=np.float64)
    is_integer = np.dtype(kind).kind in "iu"
    if is_integer and not ((numbers >= np.iinfo(kind).min) & (numbers <= np.iinfo(kind).max)).all():
        raise ValueError(f"a number does not fit into {kind}")
    with np.errstate(over="ignore"):  # a double beyond float's range becomes infinite, which is refused later
        return numbers.astype(kind)


def require_bytes(data: bytes, at: int, size: int) -> None:
    """Raise before anything is allocated for a count that the file cannot hold."""
    if at + size > len(data):
        raise ValueError(f"needs {size} bytes, {len(data) - at} are left")


@dataclass(frozen=True, kw_only=True)
class PlyProperty:
    """Name and numpy kind of a property; `count_kind` is the kind of a list's length, empty for a scalar."""

    name: str
    kind: str
    count_kind: str = ""


@dataclass(frozen=True, kw_only=True)
class PlyElement:
    """Name, number of rows and properties of an element."""

    name: str
    count: int
    properties: list[PlyProperty] = field(default_factory=list)

    @property
    def has_list(self) -> bool:
        """True if a property is a list."""
        return any(p.count_kind for p in self.properties)

    @property
    def most_bytes(self) -> int:
        """More bytes than its rows take, as text or binary."""
        row = sum(_MOST_BYTES_OF_A_LIST if p.count_kind else _MOST_BYTES_OF_A_NUMBER for p in self.properties)
        return self.count * row


def parse_ply_header(data: bytes, name: str, size: int) -> tuple[str, list[PlyElement], int]:
    """Return the byte order (`<`, `>` or `ascii`), the elements and where their data begins.

    data: the beginning of the file. size: of the file, bytes.
    """
    if not data.startswith(b"ply"):
        raise BadMesh(f"{name}: is not a PLY file")
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    newline = data.find(b"\n", end)
    if end < 0 or newline < 0:
        raise BadMesh(f"{name}: the PLY header has no end")
    order = ""
    elements: list[PlyElement] = []
    for line in data[:end].decode("ascii", "replace").splitlines()[1:]:
        words = line.split()
        try:
            match words:
                case ["format", kind, _]:
                    order = _ORDERS[kind]
                case ["element", element, count] if int(count) >= 0:
                    elements.append(PlyElement(name=element, count=int(count)))
                case ["property", "list", count_kind, kind, prop] if _KINDS[count_kind][0] != "f":
                    elements[-1].properties.append(
                        PlyProperty(name=prop, kind=_KINDS[kind], count_kind=_KINDS[count_kind])
                    )
                case ["property", kind, prop]:
                    elements[-1].properties.append(PlyProperty(name=prop, kind=_KINDS[kind]))
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise ValueError
        except (KeyError, IndexError, ValueError) as problem:
            raise BadMesh(f"{name}: unknown line in the PLY header: '{line[:60]}'") from problem
    if not order:
        raise BadMesh(f"{name}: the PLY header names no format")
    least = sum(e.count for e in elements if e.properties)  # every row takes a byte at least
    if least > size - newline:
        raise BadMesh(f"{name}: the header promises {least} rows, but only {size - newline} bytes follow")
    require_vertices(max((e.count for e in elements if e.name == "vertex"), default=0), name)
    return order, elements, newline + 1


def read_ply_counts(path: Path | str) -> dict[str, int]:
    """Return {element: rows} that the header of a PLY promises; its rows are not read. Raises `BadMesh`."""
    with opened(path, BadMesh) as stream:
        data, size = stream.read(_LONGEST_HEADER), os.fstat(stream.fileno()).st_size
    return {element.name: element.count for element in parse_ply_header(data, str(path), size)[1]}
