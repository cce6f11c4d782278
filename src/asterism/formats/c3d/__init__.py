"""C3D files of all vendors: read, described and written with all that they hold."""

from asterism.formats.c3d._describe import describe_c3d
from asterism.formats.c3d._reader import read_c3d
from asterism.formats.c3d._writer import write_c3d, write_c3d_points

__all__ = ["describe_c3d", "read_c3d", "write_c3d", "write_c3d_points"]
