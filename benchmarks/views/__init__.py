"""Labels in the images of few cameras."""
