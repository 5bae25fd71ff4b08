"""A template on a gel that follows the gel's material: the membrane tells where, the depth how deep."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from vntoolkit.arrays import Array, Points2
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.tactile.motion import Membrane, MembraneMotion
from vntoolkit.tracking.flow import targets_on_surface
from vntoolkit.tracking.slopes import sample_image
from vntoolkit.tracking.template import template_from_maps
from vntoolkit.tracking.tracker import TrackedFrame, tracked_frame

_INVERSIONS = 5  # of the motion at rest, from that in the template frame: each leaves a part of the strain


class MembraneTracker:
    """Follows one template, frame by frame, as `SurfaceTracker` does."""

    def __init__(
        self,
        normal_map: NormalMap,
        depth_map: DepthMap,
        camera: Camera,
        membrane: Membrane,
        paint: Array,
        seams: Sequence[Points2] = (),
    ) -> None:
        """normal_map, depth_map: of the template frame. paint: (h, w), the membrane's picture of it.
        seams: as of `SurfaceTracker`."""
        self.camera, self._membrane = camera, membrane
        self.template = template_from_maps(normal_map, depth_map, camera, seams)
        self._first = self.running = membrane.follow(paint)
        places = rest = self.template.positions_px
        at_rest = membrane.displacement_at_rest(self._first)
        for _ in range(_INVERSIONS):
            rest = places - sample_image(at_rest, rest)
        self._rest_px = rest
        self._nearest = cKDTree(self._first.rest_px).query(rest)[1]
        self.state = tracked_frame(self.template.vertices_in_camera, np.zeros(len(places)), camera)

    @property
    def mesh(self) -> Mesh:
        """The template as a mesh."""
        return Mesh(vertices=self.template.vertices_in_camera, faces=self.template.faces)

    def step(
        self, normal_map: NormalMap, depth_map: DepthMap, labels: object = None, paint: Array | None = None
    ) -> TrackedFrame:
        """Follow the material into the next frame. paint: the membrane's picture; labels are not needed."""
        assert paint is not None
        self.running = self._membrane.follow(paint, self.running)
        places = self._rest_px + sample_image(
            self._membrane.displacement_at_rest(self.running), self._rest_px
        )
        before = self.state.vertices_in_camera[:, 2]
        targets, _ = targets_on_surface(places, depth_map, self.camera, before)
        found, error = self.running.found[self._nearest], self.running.error_px[self._nearest]
        self.state = tracked_frame(targets, np.where(found, error, np.inf), self.camera)
        return self.state

    def resume(
        self,
        before: TrackedFrame,
        state: TrackedFrame,
        previous: NormalMap,
        running: MembraneMotion | None = None,
    ) -> None:
        """Continue from the results of the last frame and the motion there; without it, from the template."""
        self.state = state
        self.running = self._first if running is None else running
