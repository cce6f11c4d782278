"""Labelled recordings in; their wrong labels, and the recordings without them, out (thesis 6.2)."""

from asterism.labelling.audit.damage import AuditRules, audit, remove_errors
from asterism.labelling.audit.errors import LabelError
from asterism.labelling.audit.mend import mend_errors
from asterism.labelling.audit.names import NamesAsked, check_names

__all__ = ["AuditRules", "LabelError", "NamesAsked", "audit", "check_names", "mend_errors", "remove_errors"]
