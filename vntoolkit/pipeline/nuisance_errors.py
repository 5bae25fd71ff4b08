"""Normal error caused by each nuisance of a real camera: with it alone, and with all others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from vntoolkit.evaluation.angular_error import AngularError, compare_normals
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.simulation.image_formation import true_varying_response
from vntoolkit.simulation.nuisances import Nuisances, nuisance_names
from vntoolkit.simulation.render import RenderOptions, render_frame
from vntoolkit.simulation.scene import Scene


@dataclass(frozen=True, kw_only=True)
class NuisanceError:
    """One row of the table.

    name: of the nuisance; "all" and "none" frame the table. alone: error with this nuisance only. without:
    error with all others, or None where that is meaningless.
    """

    name: str
    alone: AngularError
    without: AngularError | None


def nuisance_errors(
    scene: Scene,
    nuisances: Nuisances,
    frame: int = 0,
    rendering: RenderOptions | None = None,
    seed: int = 0,
    degree: int = 0,
) -> Iterator[NuisanceError]:
    """Yield the normal error of equation 1's inversion: "none", every nuisance in turn, "all".

    The true M of each world is used, so that what is left is the nuisance's own doing and no calibration's.
    degree: of the polynomials by which M follows near lights over the image; 0 for M at the scene's centre.
    """

    def error(world: Nuisances) -> AngularError:
        shot = render_frame(scene, frame, nuisances=world, options=rendering, seed=seed)
        truth = shot.truth.normals
        return compare_normals(
            normals_from_frame(shot.linear, true_varying_response(scene, world, degree), truth.mask), truth
        )

    yield NuisanceError(name="none", alone=error(Nuisances.none()), without=None)
    for name in nuisance_names():
        yield NuisanceError(
            name=name, alone=error(nuisances.only(name)), without=error(nuisances.without(name))
        )
    yield NuisanceError(name="all", alone=error(nuisances), without=None)
