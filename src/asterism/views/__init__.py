"""Blobs of few cameras and a body model in; labels in the images, and every marker that a camera shows in space, out."""

from asterism.views.label import label_views
from asterism.views.result import ViewsLabelling
from asterism.views.rules import ViewsRules

__all__ = ["ViewsLabelling", "ViewsRules", "label_views"]
