"""The one decorator of all numerical kernels."""
