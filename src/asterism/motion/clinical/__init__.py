"""A recording with the markers of a gait laboratory in; clinical angles of hip, knee and ankle, and how certain they are, out."""

from asterism.motion.clinical.angles import CLINICAL, ClinicalAngles, ClinicalJoint, clinical_angles, complete_legs
from asterism.motion.clinical.measures import LegMeasures, leg_measures
from asterism.motion.clinical.uncertainty import (
    ClinicalErrors,
    ClinicalUncertainty,
    JointUncertainty,
    SkinMotion,
    clinical_uncertainty,
)

__all__ = [
    "CLINICAL",
    "ClinicalAngles",
    "ClinicalErrors",
    "ClinicalJoint",
    "ClinicalUncertainty",
    "JointUncertainty",
    "LegMeasures",
    "SkinMotion",
    "clinical_angles",
    "clinical_uncertainty",
    "complete_legs",
    "leg_measures",
]
