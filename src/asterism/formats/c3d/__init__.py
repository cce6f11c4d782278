"""C3D files of all vendors: read, described and written so that nothing in them is lost."""

from asterism.formats.c3d._reader import read_c3d

__all__ = ["read_c3d"]
