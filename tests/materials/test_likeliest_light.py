"""Light on printed cloth: more exact than colour over reflectance, and no more even than it is."""

import numpy as np
from scipy.ndimage import gaussian_filter

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.materials.mixtures import Seams, near_seams
from vntoolkit.materials.relighting import relit
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

DIRECTIONS = np.array([[0.5, 0.0, -0.866], [-0.25, 0.433, -0.866], [-0.25, -0.433, -0.866]])
COLOURS = np.array([[0.7, 0.1, 0.02], [0.08, 0.6, 0.1], [0.02, 0.12, 0.65]])
RESPONSE = LightResponse(matrix=COLOURS.T @ DIRECTIONS, light_colours=COLOURS)
YARNS = np.array([[0.66, 0.63, 0.58], [0.2, 0.25, 0.46]])
LEVEL = 1 / 255
NOISE = tuple(LEVEL * np.linalg.norm(RESPONSE.contributions_from_rgb, axis=1))
SEAMS = Seams(blur_px=1.0, tolerance=0.02**2, steps=0.015**2, noise=NOISE)


def dome(size: int = 120) -> tuple[FloatArray, Mask]:
    """Normals (size, size, 3) of a sphere's cap that faces the camera within 45 degrees, and its mask."""
    v, u = (np.indices((size, size)) - (size - 1) / 2) / (size / 2)
    x, y = 0.7 * u, 0.7 * v
    return np.stack([x, y, -np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))], axis=-1), u * u + v * v < 1.0


def filmed(normals: FloatArray, labels: FloatArray, backdrop: float = 0.0) -> LinearFrame:
    """Photograph a surface whose normals outside the picture go on, with a blur and noise."""
    light = np.maximum(normals @ DIRECTIONS.T, 0.0) * YARNS[labels] @ COLOURS + backdrop
    light = gaussian_filter(light, (1.0, 1.0, 0.0))
    return LinearFrame((light + np.random.default_rng(0).normal(0.0, LEVEL, light.shape)).astype(np.float32))


def errors_deg(frame: LinearFrame, normals: FloatArray, mask: Mask) -> FloatArray:
    found = normals_from_frame(frame, RESPONSE, mask).normals_in_camera
    return np.degrees(np.arccos(np.clip((found * normals).sum(axis=-1), -1.0, 1.0)))


def test_noise_of_dark_yarn_is_weighed_with_its_neighbours_and_the_length_of_normals() -> None:
    normals, mask = dome()
    labels = (np.indices(mask.shape)[1] // 12 % 2).astype(np.uint8)
    frame = filmed(normals, labels)
    plain = errors_deg(relit(frame, RESPONSE, labels, YARNS), normals, mask)
    weighed = errors_deg(relit(frame, RESPONSE, labels, YARNS, seams=SEAMS, mask=mask), normals, mask)
    inner = mask & ~near_seams(labels, 4) & (np.indices(mask.shape)[0] // 40 == 1)
    dark = inner & (labels == 1)
    assert weighed[dark].mean() < 0.6 * plain[dark].mean()
    assert weighed[inner].mean() < plain[inner].mean()


def test_seams_off_by_a_pixel_turn_normals_by_a_third_of_what_they_would() -> None:
    normals, mask = dome()
    columns = np.indices(mask.shape)[1]
    labels, thought = ((columns + off) // 12 % 2 for off in (0, 1))
    frame, thought = filmed(normals, labels), thought.astype(np.uint8)
    beside = mask & near_seams(thought, 2) & (np.hypot(*(np.indices(mask.shape) - 59.5)) < 50)
    plain, weighed = (
        errors_deg(relit(frame, RESPONSE, thought, YARNS, seams=seams, mask=mask), normals, mask)[beside]
        for seams in (None, SEAMS)
    )
    assert weighed.mean() < 0.33 * plain.mean()


def test_a_crease_inside_a_yarn_stays_sharp() -> None:
    _, mask = dome()
    v, u = np.indices(mask.shape)
    slope = np.where(u < 60, 0.5, -0.5)
    normals = np.stack([slope, 0.0 * slope, -np.sqrt(1.0 - slope**2)], axis=-1)
    labels = (v >= 60).astype(np.uint8)
    frame = filmed(normals, labels)
    crease = mask & (np.abs(u - 59.5) < 4) & ~near_seams(labels, 4)
    plain, weighed = (
        errors_deg(relit(frame, RESPONSE, labels, YARNS, seams=seams, mask=mask), normals, mask)[crease]
        for seams in (None, SEAMS)
    )
    assert weighed.mean() < 1.1 * plain.mean()


def test_what_is_outside_the_mask_tells_nothing_of_the_subject() -> None:
    normals, mask = dome()
    labels = (np.indices(mask.shape)[1] // 12 % 2).astype(np.uint8)
    frame = filmed(normals, labels)
    other = LinearFrame(np.where(mask[..., None], frame.rgb, np.float32(0.9)))
    first, second = (
        relit(each, RESPONSE, labels, YARNS, seams=SEAMS, mask=mask).rgb[mask] for each in (frame, other)
    )
    assert np.array_equal(first, second)
    assert np.isfinite(relit(frame, RESPONSE, labels, YARNS, seams=SEAMS, mask=mask).rgb).all()


def test_a_mirrored_picture_has_the_mirrored_light() -> None:
    normals, mask = dome(101)  # its rows end inside the last chunk of pixels that is done at once
    labels = (np.indices(mask.shape)[1] // 12 % 2).astype(np.uint8)
    frame = filmed(normals, labels)
    found = relit(frame, RESPONSE, labels, YARNS, seams=SEAMS, mask=mask).rgb
    mirrored = (np.ascontiguousarray(each[:, ::-1]) for each in (frame.rgb, labels, mask))
    rgb, labels, mask = mirrored
    again = relit(LinearFrame(rgb), RESPONSE, labels, YARNS, seams=SEAMS, mask=mask).rgb
    np.testing.assert_allclose(again[mask], found[:, ::-1][mask], rtol=1e-4, atol=1e-5)
