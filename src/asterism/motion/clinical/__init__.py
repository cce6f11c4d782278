"""A recording with the markers of a gait laboratory in; clinical angles, and how certain they are, out."""

from asterism.motion.clinical.angles import CLINICAL, ClinicalAngles, ClinicalJoint, clinical_angles, complete_legs
from asterism.motion.clinical.exchanged import exchanged_finding, exchanged_pairs
from asterism.motion.clinical.gathered import gathered_measures
from asterism.motion.clinical.kinetics import (
    ABOUT_CENTRE,
    KineticErrors,
    KineticRules,
    Kinetics,
    PlateContact,
    SegmentInertia,
    inverse_dynamics,
)
from asterism.motion.clinical.measures import ArmMeasures, LegMeasures, SubjectMeasures, leg_measures, subject_measures
from asterism.motion.clinical.model import MODELS, ClinicalModel
from asterism.motion.clinical.plug_in_gait import Leg, LowerBody, lower_body
from asterism.motion.clinical.static import StaticRules, with_static_offsets
from asterism.motion.clinical.uncertainty import (
    ClinicalErrors,
    ClinicalUncertainty,
    JointUncertainty,
    SkinMotion,
    clinical_uncertainty,
)

__all__ = [
    "ABOUT_CENTRE",
    "CLINICAL",
    "MODELS",
    "ArmMeasures",
    "ClinicalAngles",
    "ClinicalErrors",
    "ClinicalJoint",
    "ClinicalModel",
    "ClinicalUncertainty",
    "JointUncertainty",
    "KineticErrors",
    "KineticRules",
    "Kinetics",
    "Leg",
    "LegMeasures",
    "LowerBody",
    "PlateContact",
    "SegmentInertia",
    "SkinMotion",
    "StaticRules",
    "SubjectMeasures",
    "clinical_angles",
    "clinical_uncertainty",
    "complete_legs",
    "exchanged_finding",
    "exchanged_pairs",
    "gathered_measures",
    "inverse_dynamics",
    "leg_measures",
    "lower_body",
    "subject_measures",
    "with_static_offsets",
]
