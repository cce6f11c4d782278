"""Labelled recordings in; their wrong labels, and the recordings without them, out (thesis 6.2)."""

from asterism.labelling.audit.damage import AuditRules, audit, remove_errors
from asterism.labelling.audit.errors import LabelError

__all__ = ["AuditRules", "LabelError", "audit", "remove_errors"]
