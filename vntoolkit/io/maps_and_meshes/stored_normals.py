"""Normal maps as other programs write them: their files, encodings and backgrounds.

What is stored becomes unit vectors in the file's own axes. What had to be assumed is said in notes.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Array, Float32Array, FloatArray, Mask
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.io.files import require_file
from vntoolkit.io.maps_and_meshes.exr import read_exr
from vntoolkit.io.maps_and_meshes.maps import CONVENTION_ATTRIBUTE, ERROR_CHANNEL
from vntoolkit.options.export import NormalConvention

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".exr", ".npz", ".mat")
_SHORTEST, _LONGEST = 0.5, 1.5  # length of a vector that is meant to be a normal
_ROUNDED = 0.05  # lengths that 8 bits and averaging make
_MOST_OF_BORDER = 0.5  # of the picture's border, which a background covers
_LEVEL = 1.5 / 255  # mid grey is stored as 127 or 128


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredNormals:
    """vectors: (h, w, 3) float32 of length 1, in the axes of the file; 0 outside mask (h, w).

    weight, error_deg: (h, w) or None, as our own EXR files hold. convention: that the file states, or None.
    notes: what was assumed, a line each.
    """

    vectors: Float32Array
    mask: Mask
    weight: Float32Array | None = None
    error_deg: Float32Array | None = None
    convention: NormalConvention | None = None
    notes: tuple[str, ...] = ()


def read_stored_normals(
    path: Path | str, mask: Mask | None = None, *, max_megapixels: float | None = None
) -> StoredNormals:
    """Read a normal map: PNG, TIFF or JPEG of 8 or 16 bits or floats, EXR, NPZ, or MAT as DiLiGenT's."""
    path = Path(path)
    weight, error, stated, alpha = None, None, None, None
    match path.suffix.lower():
        case ".exr":
            samples, weight, error, stated = _exr_planes(path, max_megapixels)
            alpha = None if weight is None else weight > 0
        case ".npz" | ".mat":
            samples = _normals_of_archive(path)
        case _:
            from vntoolkit.io.footage.images import read_image_with_alpha

            samples, alpha = read_image_with_alpha(path, max_megapixels=max_megapixels)
    if mask is not None and mask.shape != samples.shape[:2]:
        (height, width), (rows, columns) = mask.shape, samples.shape[:2]
        raise BadInput(f"{path}: is {columns}×{rows} but its mask is {width}×{height}; give one of its size")
    inside = alpha if mask is None else (mask if alpha is None else alpha & mask)
    found = stored_normals(samples, inside, str(path), is_own=stated is not None)
    graded = weight is not None and bool((weight[found.mask] < 1).any())
    return replace(
        found,
        weight=weight if graded else None,
        error_deg=None if error is None else np.where(found.mask, error, np.float32(0)),
        convention=stated,
    )


def _exr_planes(
    path: Path, max_megapixels: float | None
) -> tuple[Float32Array, Float32Array | None, Float32Array | None, NormalConvention | None]:
    """Return what an EXR holds of normals: vectors (h, w, 3) as stored, confidence, errors, stated axes."""
    channels, texts = read_exr(path, max_megapixels=max_megapixels, error=BadInput)
    names = next((n for n in ("RGB", "XYZ", "xyz") if set(n) <= set(channels)), None)
    if names is None:
        raise BadInput(f"{path}: expected the channels R, G, B or X, Y, Z, found {', '.join(channels)}")
    stored = np.stack([channels[name] for name in names], axis=-1, dtype=np.float32, casting="unsafe")
    weight = channels["A"].astype(np.float32) if "A" in channels else None
    error = channels[ERROR_CHANNEL].astype(np.float32) if ERROR_CHANNEL in channels else None
    bad = 0 if weight is None else int((~np.isfinite(stored).all(axis=2) & (weight > 0)).sum())
    if bad:
        raise BadInput(f"{path}: {bad} normals are NaN or infinite")
    convention = texts.get(CONVENTION_ATTRIBUTE)
    try:
        stated = None if convention is None else NormalConvention(convention)
        return stored, weight, error, stated
    except ValueError as problem:
        raise BadInput(f"{path}: unknown normal convention '{convention}'") from problem


def stored_normals(samples: Array, mask: Mask | None, name: str, *, is_own: bool = False) -> StoredNormals:
    """Decode samples (h, w, 3) of a file or of a video's frame. mask: (h, w); None finds the background.

    is_own: the file is this program's, and holds floats of length 1.
    """
    require_shape(samples, (None, None, 3), name)
    if samples.dtype.kind not in "uif":
        raise BadInput(f"{name}: expected numbers, got {samples.dtype}")
    notes = []
    inside = np.asarray(np.isfinite(samples).all(axis=2))
    background = None if mask is not None else _background(samples)
    if mask is not None:
        inside &= mask
    elif background is not None:
        inside &= ~background[1]
        notes.append(f"{background[0]} at the border was taken for background")
    vectors, encoding = (samples, "") if is_own else _decoded(samples, inside)
    notes += [encoding] if encoding else []
    lengths = np.sqrt(np.einsum("...c,...c", vectors, vectors))
    inside &= (lengths > _SHORTEST) & (lengths < _LONGEST)
    if not inside.any():
        raise BadInput(
            f"{name}: expected normals, vectors of length 1, got none of length {_SHORTEST} to {_LONGEST}; "
            "give a normal map, and a --mask of its subject"
        )
    median = float(np.median(lengths[inside]))
    if abs(median - 1.0) > _ROUNDED:
        notes.append(f"vectors of length {median:.2f} (median) were brought to length 1")
    unit = np.zeros(vectors.shape, np.float32)
    np.divide(vectors, lengths[..., None], out=unit, where=inside[..., None], casting="same_kind")
    return StoredNormals(vectors=unit, mask=inside, notes=tuple(notes))


def _background(samples: Array) -> tuple[str, Mask] | None:
    """Return the name of what surrounds the subject, and where (h, w) it is; None where nothing does."""
    border = np.concatenate([samples[0], samples[-1], samples[:, 0], samples[:, -1]])
    colours, counts = np.unique(border, axis=0, return_counts=True)
    most = colours[counts.argmax()]
    if counts.max() < _MOST_OF_BORDER * len(border) or not np.isfinite(most).all():
        return None
    full = np.iinfo(samples.dtype).max if np.issubdtype(samples.dtype, np.integer) else 1.0
    level = most.astype(np.float64) / full
    named = {
        "black": np.all(level == 0), "white": np.all(level == 1),
        "grey": np.all(np.abs(level - 0.5) < _LEVEL),
        "flat blue": np.all(np.abs(level - [0.5, 0.5, 1.0]) < _LEVEL),
    }  # fmt: skip
    name = next((name for name, is_that in named.items() if is_that), None)
    if name is None:
        return None
    from scipy import ndimage

    labels, _ = ndimage.label((samples == most).all(axis=2))
    at_border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    return name, np.asarray(np.isin(labels, at_border[at_border > 0]))


def _decoded(samples: Array, inside: Mask) -> tuple[FloatArray, str]:
    """Return vectors from samples: n = value · 2 / full − 1, or floats as they are; and a note."""
    if np.issubdtype(samples.dtype, np.integer):
        return samples * (2.0 / np.iinfo(samples.dtype).max) - 1.0, ""
    plain = np.where(inside[..., None], samples, 0).astype(np.float64).clip(-_LONGEST, _LONGEST)
    shifted, some = 2.0 * plain - 1.0, plain[inside]
    if len(some) and some.min() >= 0 and _off(2.0 * some - 1.0) < _off(some):
        return shifted, "floats from 0 to 1 were read as n = 2 · value − 1"
    return plain, ""


def _off(vectors: FloatArray) -> float:
    return float(np.median(np.abs(np.linalg.norm(vectors, axis=1) - 1.0)))


def _normals_of_archive(path: Path) -> Array:
    """Return the one array (h, w, 3) of an archive; of several, the one that is named for normals."""
    from vntoolkit.io.maps_and_meshes.arrays import read_npz

    shapes = _shapes_in(require_file(path))
    maps = [name for name, shape in shapes.items() if len(shape) == 3 and shape[2] == 3]
    maps = [name for name in maps if "normal" in name.lower()] or maps
    if len(maps) != 1:
        held = ", ".join(f"{name} {shape}" for name, shape in shapes.items()) or "nothing"
        raise BadInput(f"{path}: expected one array (h, w, 3) of normals, it holds {held}")
    if path.suffix.lower() == ".npz":
        from vntoolkit.io.maps_and_meshes.arrays import read_npz

        return read_npz(path, maps[0])
    from scipy.io import loadmat

    return np.asarray(loadmat(path, variable_names=maps)[maps[0]])


def _shapes_in(path: Path) -> dict[str, tuple[int, ...]]:
    try:
        if path.suffix.lower() == ".mat":
            from scipy.io import whosmat

            return {name: shape for name, shape, _ in whosmat(path)}
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name].shape for name in archive.files}
    except (ValueError, OSError, EOFError, NotImplementedError, AttributeError, KeyError) as problem:
        raise BadInput(f"{path}: is no whole {path.suffix} archive of arrays ({problem})") from problem
