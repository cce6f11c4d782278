"""A recording with the markers of a gait laboratory in; clinical angles of hip, knee and ankle, left and right, out."""

from asterism.motion.clinical.angles import CLINICAL, ClinicalAngles, ClinicalJoint, clinical_angles, complete_legs
from asterism.motion.clinical.measures import LegMeasures, leg_measures

__all__ = ["CLINICAL", "ClinicalAngles", "ClinicalJoint", "LegMeasures", "clinical_angles", "complete_legs", "leg_measures"]
