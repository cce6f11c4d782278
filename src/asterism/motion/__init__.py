"""Motion of points along their paths through time."""

from asterism.motion.smoothing import SmoothingRules, SmoothPaths, smooth_paths

__all__ = ["SmoothPaths", "SmoothingRules", "smooth_paths"]
