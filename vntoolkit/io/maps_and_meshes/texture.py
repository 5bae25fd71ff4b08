"""Images on the texture coordinates of a surface, and their copies beside the files that show them."""

from dataclasses import dataclass
from pathlib import Path

from vntoolkit.io.atomic import write_bytes


@dataclass(frozen=True, kw_only=True)
class SurfaceTexture:
    """PNG files of a texture. albedo: sRGB, or None. normal: tangent space, x along u, y along v, z outwards.

    A GLB holds their bytes; USD and OBJ name files in their own folder.
    """

    albedo: Path | None
    normal: Path

    def beside(self, path: Path) -> "SurfaceTexture":
        """Copy the files beside another, as STEM_albedo.png and STEM_normal.png, and return the copies."""

        def copied(source: Path) -> Path:
            copy = path.with_name(f"{path.stem}_{source.name}")
            write_bytes(copy, source.read_bytes())
            return copy

        return SurfaceTexture(
            albedo=None if self.albedo is None else copied(self.albedo), normal=copied(self.normal)
        )
