"""Labelled recordings in; what a model keeps of them out."""
