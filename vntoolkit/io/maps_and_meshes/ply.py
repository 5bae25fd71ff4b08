"""Stanford PLY: vertices with normals, colour and texture coordinates, and faces; ASCII and binary."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Array, Faces, Float32Array, FloatArray
from vntoolkit.errors import BadMesh
from vntoolkit.geometry.mesh import Mesh, triangles_from_polygons
from vntoolkit.io.atomic import aligned_memory, write_large
from vntoolkit.io.files import opened, require_vertices

_KINDS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
_LONGEST_HEADER = 1 << 16
_MOST_BYTES_OF_A_NUMBER = 32
_MOST_BYTES_OF_A_LIST = 1 << 12  # a polygon of hundreds of corners


def write_ply(
    path: Path | str,
    vertices: FloatArray,
    faces: Faces | None = None,
    *,
    normals: FloatArray | None = None,
    colours: FloatArray | None = None,
    uv: FloatArray | None = None,
    quality: FloatArray | None = None,
    comment: str = "x right, y up, z towards the viewer",
) -> None:
    """Write little-endian binary: float32 `x y z nx ny nz s t quality`, uchar `red green blue`, triangles.

    All in the frame of the file. vertices, normals, colours (0 to 1): (n, 3). faces: (m, 3), None for a point
    cloud. uv: (n, 2). quality: (n,), MeshLab's name for one number a vertex.
    """
    columns: dict[str, tuple[str, Array | None]] = {
        "x y z": ("<f4", vertices),
        "nx ny nz": ("<f4", normals),
        "s t": ("<f4", uv),
        "quality": ("<f4", quality),
        "red green blue": ("u1", None if colours is None else np.rint(np.clip(colours * 255.0, 0, 255))),
    }
    given = {names: (kind, values) for names, (kind, values) in columns.items() if values is not None}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {comment}",
        f"element vertex {len(vertices)}",
    ]
    for names, (kind, _) in given.items():
        header += [f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name in names.split()]
    if faces is not None:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    head = "\n".join([*header, "end_header\n"]).encode("ascii")
    row = np.dtype([(names, kind, values.shape[1:]) for names, (kind, values) in given.items()])
    end = len(head) + row.itemsize * len(vertices)
    memory = aligned_memory(end + (0 if faces is None else _FACE.itemsize * len(faces)))
    memory[: len(head)] = np.frombuffer(head, np.uint8)
    rows, triangles = memory[len(head) : end].view(row), memory[end:].view(_FACE)
    for names, (_, values) in given.items():
        rows[names] = values
    if faces is not None:
        triangles["count"], triangles["corners"] = 3, faces
    write_large(path, memory.data)


def read_ply(path: Path | str) -> Mesh:
    """Read a mesh in the frame of the file; raise `BadMesh` with one line for a malformed one."""
    with opened(path, BadMesh) as stream:
        data = stream.read(_LONGEST_HEADER)
        size = os.fstat(stream.fileno()).st_size
        order, elements, at = parse_ply_header(data, str(path), size)
        if size > _LONGEST_HEADER + sum(element.most_bytes for element in elements):
            raise BadMesh(f"{path}: {size / 1e6:.0f} MB are more than the rows that its header promises take")
        data += stream.read()
    tables: dict[str, dict[str, Any]] = {}
    element = elements[0] if elements else PlyElement(name="vertex", count=0)
    try:
        numbers = _Numbers(data, at, order)
        for element in elements:
            tables[element.name] = _table(element, numbers)
    except (ValueError, IndexError) as problem:
        raise BadMesh(
            f"{path}: the element '{element.name}' is malformed or cut off ({problem})"
        ) from problem
    columns = tables.get("vertex", {}).items()
    vertex = {key: values for key, values in columns if isinstance(values, np.ndarray) and values.ndim == 1}
    if not {"x", "y", "z"} <= set(vertex):
        raise BadMesh(f"{path}: expected an element 'vertex' with x, y and z")
    if "face" not in tables:
        raise BadMesh(f"{path}: holds points but no faces, expected a mesh")
    return _mesh(str(path), vertex, tables["face"])


def _mesh(name: str, vertex: dict[str, Array], face: dict[str, Any]) -> Mesh:
    def gather(*names: str) -> Array | None:
        return np.stack([vertex[n] for n in names], axis=1) if set(names) <= set(vertex) else None

    def gather_floats(*names: str) -> FloatArray | None:
        values = gather(*names)
        whole = values is not None and not np.issubdtype(values.dtype, np.floating)
        return values.astype(np.float64) if values is not None and whole else values

    vertices, colours, quality = (
        gather_floats("x", "y", "z"),
        gather("red", "green", "blue"),
        vertex.get("quality"),
    )
    assert vertices is not None
    pairs = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
    polygons = face.get("vertex_indices", face.get("vertex_index"))
    if polygons is None or (isinstance(polygons, np.ndarray) and polygons.ndim == 1):
        raise BadMesh(f"{name}: the faces have no list 'vertex_indices'")
    faces = triangles_from_polygons(polygons, len(vertices), name)
    try:
        return Mesh(
            vertices=vertices,
            faces=faces,
            normals=gather_floats("nx", "ny", "nz"),
            colours=None if colours is None else _shares(colours),
            uv=next((found for pair in pairs if (found := gather_floats(*pair)) is not None), None),
            error_deg=None if quality is None or not np.isfinite(quality).all() else quality,
        )
    except BadMesh as problem:
        raise BadMesh(f"{name}: {problem}") from problem


def _shares(colours: Array) -> Float32Array:
    """Return colours as 0 to 1: floats are, 16 bits count to 65535, other integers to 255."""
    is_float, is_short = np.issubdtype(colours.dtype, np.floating), colours.dtype == np.uint16
    full = np.float32(1 if is_float else 65535 if is_short else 255)
    return np.clip(colours.astype(np.float32) / full, 0, 1)


class _Numbers:
    """The numbers behind a header, taken one after the other. Those of a text are doubles of any kind."""

    def __init__(self, data: bytes, at: int, order: str) -> None:
        self.is_text, self.order = order == "ascii", order
        self.data, self.at = data, at
        if self.is_text:
            self.data, self.at = np.fromstring(data[at:].strip(), sep=" ").tobytes(), 0

    def stored(self, kind: str) -> str:
        """Return how a PLY kind is stored."""
        return "f8" if self.is_text else self.order + kind

    def hold(self, kind: npt.DTypeLike, count: int) -> bool:
        """Tell whether so many are left."""
        return count * np.dtype(kind).itemsize <= len(self.data) - self.at

    def take(self, kind: npt.DTypeLike, count: int) -> Array:
        """Return the next ones; raise before anything is allocated for a count that the file cannot hold."""
        if not self.hold(kind, count):
            raise ValueError(f"it promises {count} rows or numbers more than are left")
        values = np.frombuffer(self.data, kind, count, self.at)
        self.at += values.nbytes
        return values

    def of_kind(self, values: Array, kind: str) -> Array:
        """Return them as a PLY kind; of a text NaN and what exceeds an integer raise."""
        is_integer = self.is_text and np.dtype(kind).kind in "iu"
        if is_integer and not ((values >= np.iinfo(kind).min) & (values <= np.iinfo(kind).max)).all():
            raise ValueError(f"a number does not fit into {kind}")
        with np.errstate(over="ignore"):  # a double beyond float's range becomes infinite: refused later
            return values.astype(kind)


def _table(element: "PlyElement", numbers: _Numbers) -> dict[str, Any]:
    """Read one element; one whose lists are all as long as those of its first row takes the fast way."""
    start = numbers.at
    first = _rows(element, numbers, min(1, element.count))
    numbers.at = start
    fields: list[Any] = []
    for p in element.properties:
        if p.count_kind:
            fields.append(("\0" + p.name, numbers.stored(p.count_kind)))
        length = (len(first[p.name][0]) if element.count else 0,) if p.count_kind else ()
        fields.append((p.name, numbers.stored(p.kind), length))
    row, lists = np.dtype(fields), [p.name for p in element.properties if p.count_kind]
    if not lists or numbers.hold(row, element.count):
        table = numbers.take(row, element.count)
        if all((table["\0" + name] == table[name].shape[1]).all() for name in lists):
            return {p.name: numbers.of_kind(table[p.name], p.kind) for p in element.properties}
        numbers.at = start
    return _rows(element, numbers, element.count)


def _rows(element: "PlyElement", numbers: _Numbers, count: int) -> dict[str, Any]:
    """Read rows one by one."""
    table: dict[str, list[Array]] = {p.name: [] for p in element.properties}
    for _ in range(count):
        for p in element.properties:
            length = int(numbers.take(numbers.stored(p.count_kind), 1)[0]) if p.count_kind else 1
            if length < 0:
                raise ValueError("a list of negative length")
            table[p.name].append(numbers.of_kind(numbers.take(numbers.stored(p.kind), length), p.kind))
    return {
        p.name: table[p.name] if p.count_kind else np.concatenate(table[p.name] or [np.empty(0)])
        for p in element.properties
    }


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
