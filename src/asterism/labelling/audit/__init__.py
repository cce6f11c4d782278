"""Labelled recordings in; where their labels cannot be right, and the recordings without those samples, out (thesis 6.2)."""

from asterism.labelling.audit.damage import AuditRules, audit, without
from asterism.labelling.audit.errors import LabelError

__all__ = ["AuditRules", "LabelError", "audit", "without"]
