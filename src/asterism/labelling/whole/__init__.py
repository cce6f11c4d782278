"""Tracks of a recording: clouds in; tracklets and labellings of whole recordings out."""
