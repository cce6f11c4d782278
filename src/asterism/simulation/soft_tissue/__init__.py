"""A joint and a subject in; points on skin that slides, bulges and wobbles over bones, with the bones' true motion, out."""

from asterism.simulation.soft_tissue.trials import JOINTS, SoftTissueRules, SoftTissueTrial, TrialPlan, simulate_soft_tissue

__all__ = ["JOINTS", "SoftTissueRules", "SoftTissueTrial", "TrialPlan", "simulate_soft_tissue"]
