"""The normal map of a cylinder, for captures that tests make themselves."""

from vntoolkit.evaluation.cylinder import Cylinder, intersect
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.rays import pixel_rays


def cylinder_normals(cylinder: Cylinder, camera: Camera) -> NormalMap:
    """Return the normals (h, w, 3) of the cylinder's side, ends open, wherever a pixel's ray meets it."""
    met = intersect(cylinder, *pixel_rays(camera, camera.pixel_grid()))
    return NormalMap(normals_in_camera=met.normals, mask=met.hit)
