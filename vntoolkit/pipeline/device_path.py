"""One frame on a graphics card: integers go there, normals and depth come back, nothing else travels."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import Mask
from vntoolkit.devices import Backend
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.integration.array_poisson import ArrayIntegrator
from vntoolkit.integration.options import IntegrationOptions, Integrator
from vntoolkit.io.decoding import EncodedFrame
from vntoolkit.normals.array_inversion import ArrayInverter
from vntoolkit.normals.inversion import InversionOptions
from vntoolkit.photometry.rig import Rig


class DevicePath:
    """Inverts, and integrates where every pixel is valid, with an array library's functions."""

    def __init__(
        self,
        backend: Backend,
        rig: Rig,
        mask: Mask,
        inversion: InversionOptions,
        integration: IntegrationOptions,
    ) -> None:
        self._backend, self._rig, self._inversion = backend, rig, inversion
        self._camera: Camera = rig.camera.without_distortion()
        self._inside = backend.to_device(mask)
        self._integration = integration
        self._integrator = ArrayIntegrator(backend, self._camera, integration.steepest_slope_deg)
        self._inverters: dict[tuple[int, int], ArrayInverter] = {}

    def process(self, frame: EncodedFrame) -> tuple[NormalMap, DepthMap | None]:
        """Return normals, and depth where every pixel has one and the integrator may be a spectral one."""
        inverter = self._inverter(frame)
        values = frame.values.astype(np.int32)  # not every library indexes with unsigned integers
        (x, y, z), weight, good = inverter.invert(self._backend.to_device(values), self._inside)
        host = self._backend.to_host
        normals = np.stack([host(axis) for axis in (x, y, z)], axis=-1)
        normal_map = NormalMap(normals_in_camera=normals, mask=host(good), weight=host(weight))
        if not self._is_rectangle(normal_map):
            return normal_map, None
        solution = host(self._integrator.integrate(x, y, z)).astype(np.float32)
        whole: Mask = np.ones(solution.shape, np.bool_)
        if not self._camera.is_perspective:
            unit = LengthUnit.PIXEL if self._camera.matrix[0, 0] == 1.0 else LengthUnit.METRE
            return normal_map, DepthMap(depth=solution, mask=whole, unit=unit)
        depth = np.exp(solution)
        depth /= depth.mean(dtype=np.float64)
        return normal_map, DepthMap(depth=depth, mask=whole, unit=LengthUnit.FREE)

    def _inverter(self, frame: EncodedFrame) -> ArrayInverter:
        key = (frame.bits, frame.values.dtype.itemsize * 8)
        if key not in self._inverters:
            height, width = frame.values.shape[:2]
            self._inverters[key] = ArrayInverter(
                self._backend, self._rig.response, self._rig.transfer, (height, width), self._inversion, *key
            )
        return self._inverters[key]

    def _is_rectangle(self, normal_map: NormalMap) -> bool:
        spectral = self._integration.integrator in (None, Integrator.COSINE, Integrator.FOURIER)
        weight = normal_map.weight
        assert weight is not None
        return spectral and bool((normal_map.mask & (weight >= self._integration.least_weight)).all())
