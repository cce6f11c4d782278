"""Blobs of few cameras and a body model in; labels in the images, and every marker that a camera shows in space, out."""

from asterism.views.body import ArticulatedBody, BodyMarker, Bone, Capsule, Hinge
from asterism.views.body_file import load_body, save_body, shipped_bodies
from asterism.views.body_fit import fit_body
from asterism.views.label import label_views
from asterism.views.result import ViewsLabelling
from asterism.views.rules import ViewsRules

__all__ = [
    "ArticulatedBody",
    "BodyMarker",
    "Bone",
    "Capsule",
    "Hinge",
    "ViewsLabelling",
    "ViewsRules",
    "fit_body",
    "label_views",
    "load_body",
    "save_body",
    "shipped_bodies",
]
