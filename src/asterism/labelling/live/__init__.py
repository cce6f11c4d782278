"""Labels while the points come in, frame by frame."""
