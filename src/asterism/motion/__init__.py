"""What happens to points along their paths through time."""

from asterism.motion.smoothing import SmoothPaths, smooth_paths

__all__ = ["SmoothPaths", "smooth_paths"]
