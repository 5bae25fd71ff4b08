"""`vntoolkit integrate`: depth and meshes from anyone's normal maps."""

from vntoolkit.cli.output import print_next, say
from vntoolkit.cli.verb import verb
from vntoolkit.options.normal_maps import IntegrateArguments
from vntoolkit.pipeline.integrate_normals import integrate_normals
from vntoolkit.pipeline.opened_result import OpenedResult, read_result


@verb(IntegrateArguments)
def integrate(asked: IntegrateArguments) -> OpenedResult:
    """Compute depth and meshes from normal maps of any origin.

    The folder is one as `vntoolkit reconstruct` writes: view, report and export read it.
    """
    folder = integrate_normals(asked)
    result = read_result(folder)
    count = len(result.frames)
    say(f"{folder}: depth of {count} normal map{'' if count == 1 else 's'}")
    print_next("view", folder)
    return result
