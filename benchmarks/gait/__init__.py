"""Gait analysis: clean trajectories, models, events, parameters."""
