"""A sweater through a dance: dressed, settled, then simulated frame by frame on demand."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import Points
from vntoolkit.simulation.body.capsules import Capsules
from vntoolkit.simulation.body.dancer import Pose, body_from_pose, pose_at
from vntoolkit.simulation.garment.pattern import Garment, SweaterOptions, sew_sweater
from vntoolkit.simulation.garment.solver import ClothOptions, ClothSolver

_SETTLE_FRAMES, _HANG_FRAMES, _FADE_FRAMES = 30, 30, 75


class DancingGarment:
    """The coarse cage of the garment at any frame; holds one state only.

    A later frame is simulated from the current one; an earlier one starts again from the beginning. The
    same seed gives the same bytes.
    """

    def __init__(
        self, seed: int, sweater: SweaterOptions | None = None, cloth: ClothOptions | None = None
    ) -> None:
        self.garment: Garment = sew_sweater(sweater or SweaterOptions())
        self._cloth = cloth or ClothOptions()
        self._phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 8)
        self._solver: ClothSolver | None = None  # dressed when the first frame is asked for
        self._frame = -_FADE_FRAMES

    @property
    def solver(self) -> ClothSolver:
        """The solver in its current state."""
        if self._solver is None:
            self._solver = self._dressed()
            self._frame = -_FADE_FRAMES
        return self._solver

    def body(self, frame: int) -> Capsules:
        """Return the dancer's body; before frame 0 it fades in from the rest pose."""
        fade = np.clip((frame + _FADE_FRAMES) / _FADE_FRAMES, 0.0, 1.0)
        return body_from_pose(pose_at(frame / 60.0, self._phases, float(fade * fade * (3.0 - 2.0 * fade))))

    def cage(self, frame: int) -> Points:
        """Return (n, 3) the garment's vertices, studio frame of the body, metres."""
        if self._solver is not None and frame < self._frame:
            self._solver = None
        solver = self.solver
        while self._frame < frame:
            solver.advance(self.body(self._frame), self.body(self._frame + 1))
            self._frame += 1
        return solver.positions.copy()

    def _dressed(self) -> ClothSolver:
        body = body_from_pose(Pose())
        solver = ClothSolver(self.garment, body, self._cloth)
        for _ in range(_SETTLE_FRAMES):
            solver.settle(body)
        for frame in range(_HANG_FRAMES):
            solver.draw_ribbing((frame + 1) / _HANG_FRAMES)
            solver.advance(body, body)
        return solver
