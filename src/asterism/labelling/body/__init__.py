"""Labelled frames in; a body model, its anchors, and labels of single frames by the whole body out."""
