"""The stages written against the array API give what the compiled ones give, whatever the library."""

from collections.abc import Callable

import numpy as np
import pytest

from vntoolkit.devices import Backend, Device, find_backend, numpy_backend, torch_backend
from vntoolkit.geometry.camera import Camera
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.integration.options import IntegrationOptions
from vntoolkit.io.decoding import EncodedFrame
from vntoolkit.normals.inversion import ClippedPixels, InversionOptions, normals_from_encoded
from vntoolkit.photometry.lambertian import rgb_from_normals
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, TransferCurve, encoded_from_linear
from vntoolkit.photometry.variation import ResponseVariation
from vntoolkit.pipeline.device_path import DevicePath
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.options import Product, ReconstructOptions
from vntoolkit.shadows.detector import ShadowMethod

MATRIX = np.array([[0.35, -0.02, -0.5], [-0.17, 0.3, -0.48], [-0.15, -0.28, -0.52]])
WIDTH, HEIGHT = 80, 54


def torch_on_the_processor() -> Backend:
    pytest.importorskip("torch")
    return torch_backend("cpu")


def varying() -> LightResponse:
    variation = ResponseVariation(
        powers=np.array([[1, 0], [0, 2]]),
        matrices=np.random.default_rng(1).normal(0, 0.02, (2, 3, 3)),
        ambients=np.zeros((2, 3)),
        centre_px=np.array([40.0, 27.0]),
        scale_px=40.0,
    )
    return LightResponse(matrix=MATRIX, ambient=np.array([0.02, 0.01, 0.0]), variation=variation)


def frame_of(response: LightResponse, transfer: Transfer, dtype: type) -> EncodedFrame:
    v, u = np.mgrid[:HEIGHT, :WIDTH] / 12.0
    normals = np.stack([0.4 * np.cos(u + v), 0.3 * np.sin(v - 0.5 * u), -np.ones_like(u)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    top = np.iinfo(dtype).max
    values = encoded_from_linear(0.9 * rgb_from_normals(normals, response), transfer)
    return EncodedFrame(
        values=np.round(values * top).astype(dtype), bits=int(top).bit_length(), number=0, name="f"
    )


@pytest.mark.parametrize("backend", [numpy_backend, torch_on_the_processor])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    ("camera", "response", "curve"),
    [
        (Camera.orthographic(width=WIDTH, height=HEIGHT), LightResponse(matrix=MATRIX), TransferCurve.LINEAR),
        (Camera.pinhole(width=WIDTH, height=HEIGHT, focal_px=120.0), varying(), TransferCurve.SRGB),
    ],
    ids=["orthographic", "perspective, near lights"],
)
def test_normals_and_depth_agree(
    backend: Callable[[], Backend], dtype: type, camera: Camera, response: LightResponse, curve: TransferCurve
) -> None:
    rig = Rig(camera=camera, response=response, transfer=Transfer(curve=curve))
    frame = frame_of(response, rig.transfer, dtype)
    everywhere = np.ones((HEIGHT, WIDTH), bool)
    inversion = InversionOptions(relative_albedo=0.9)
    path = DevicePath(backend(), rig, everywhere, inversion, IntegrationOptions())
    ours, depth = path.process(frame)
    theirs = normals_from_encoded(frame.values, response, rig.transfer, None, inversion)
    np.testing.assert_array_equal(ours.mask, theirs.mask)
    np.testing.assert_allclose(ours.normals_in_camera, theirs.normals_in_camera, atol=2e-6)
    np.testing.assert_allclose(ours.weight, theirs.weight, atol=1e-5)
    assert depth is not None
    reference = DepthIntegrator(camera).integrate(theirs)
    assert depth.unit is reference.unit
    assert np.abs(depth.depth - reference.depth).max() < 1e-4 * np.ptp(reference.depth)


@pytest.mark.parametrize("backend", [numpy_backend, torch_on_the_processor])
def test_masked_and_clipped_pixels_are_left_to_the_masked_integrator(backend: Callable[[], Backend]) -> None:
    rig = Rig(camera=Camera.orthographic(width=WIDTH, height=HEIGHT), response=LightResponse(matrix=MATRIX))
    frame = frame_of(rig.response, rig.transfer, np.uint8)
    values = frame.values.copy()
    values[3, 4] = 255
    values[5, 6] = 0
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[:, :3] = False
    frame = EncodedFrame(values=values, bits=8, number=0, name="f")
    for clipped in ClippedPixels:
        inversion = InversionOptions(clipped=clipped)
        ours, depth = DevicePath(backend(), rig, mask, inversion, IntegrationOptions()).process(frame)
        theirs = normals_from_encoded(values, rig.response, rig.transfer, mask, inversion)
        assert depth is None
        np.testing.assert_array_equal(ours.mask, theirs.mask)
        np.testing.assert_allclose(ours.weight, theirs.weight, atol=1e-5)


def test_without_a_card_the_ordinary_path_is_taken_silently(monkeypatch, capfd) -> None:
    monkeypatch.setattr("vntoolkit.devices._cupy", lambda: None)
    monkeypatch.setattr("vntoolkit.devices._torch_with_card", lambda: None)
    assert find_backend(Device.CUDA) is None
    rig = Rig(camera=Camera.orthographic(width=WIDTH, height=HEIGHT), response=LightResponse(matrix=MATRIX))
    frame = frame_of(rig.response, rig.transfer, np.uint8)
    results = []
    for device in Device:
        options = ReconstructOptions(to=Product.DEPTH, shadows=ShadowMethod.NONE, device=device)
        results.append(FrameProcessor(rig, options).process(frame).depth_map.depth)
    np.testing.assert_array_equal(*results)
    assert capfd.readouterr() == ("", "")


def test_a_card_takes_the_frames_of_a_reconstruction(monkeypatch) -> None:
    rig = Rig(camera=Camera.orthographic(width=WIDTH, height=HEIGHT), response=LightResponse(matrix=MATRIX))
    frame = frame_of(rig.response, rig.transfer, np.uint8)
    options = ReconstructOptions(to=Product.DEPTH, shadows=ShadowMethod.NONE, device=Device.CUDA)
    plain = FrameProcessor(rig, options).process(frame)
    monkeypatch.setattr("vntoolkit.pipeline.frame_processor.find_backend", lambda device: numpy_backend())
    processor = FrameProcessor(rig, options)
    processor.anchor_to(frame)
    result = processor.process(frame)
    assert np.abs(result.depth_map.depth - plain.depth_map.depth).max() < 1e-4 * np.ptp(plain.depth_map.depth)
    assert result.clipped_share == plain.clipped_share
