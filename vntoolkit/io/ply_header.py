"""The header of a PLY file: which elements with which properties follow."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from vntoolkit.errors import BadMesh
from vntoolkit.io.files import require_file
from vntoolkit.io.limits import require_vertices

_KINDS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 16


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


def parse_ply_header(data: bytes, name: str) -> tuple[str, list[PlyElement], int]:
    """Return the byte order (`<`, `>` or `ascii`), the elements and where their data begins."""
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
    if least > len(data) - newline:
        raise BadMesh(
            f"{name}: the header promises {least} rows, but only {len(data) - newline} bytes follow"
        )
    require_vertices(max((e.count for e in elements if e.name == "vertex"), default=0), name)
    return order, elements, newline + 1


def read_ply_counts(path: Path | str) -> dict[str, int]:
    """Return {element: rows} that the header of a PLY promises; its rows are not read."""
    with require_file(path, BadMesh).open("rb") as stream:
        lines = stream.read(_LONGEST_HEADER).split(b"end_header")[0].splitlines()
    words = [line.split() for line in lines]
    return {
        w[1].decode("ascii", "replace"): int(w[2])
        for w in words
        if len(w) == 3 and w[0] == b"element" and w[2].isdigit()
    }
