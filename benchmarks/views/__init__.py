"""The issue about labelling in the images of few cameras."""
