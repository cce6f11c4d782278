"""A recording with gaps in; the same with filled samples, a flag and a standard deviation for each, out."""

from asterism.motion.gaps.fill import Filled, fill_gaps
from asterism.motion.gaps.predict import GapRules

__all__ = ["Filled", "GapRules", "fill_gaps"]
