"""A recording with gaps in; the same with filled samples, a flag and a standard deviation for each, out."""

from asterism.motion.gaps.fill import Filled, fill_gaps
from asterism.motion.gaps.predict import GapRules
from asterism.motion.gaps.trials import marker_difference, trials_of_person

__all__ = ["Filled", "GapRules", "fill_gaps", "marker_difference", "trials_of_person"]
