"""Measures what the issues ask for, on real recordings, and writes it to `benchmarks/figures.json`."""
