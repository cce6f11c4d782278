"""Recordings and a model in; a page in the person's browser on which the labels are corrected, and the corrected files, out."""

from asterism.web.serving import PageAddress, serve
from asterism.web.session import CORRECTED, CorrectionSession, CorrectionTrial, SessionOptions

__all__ = ["CORRECTED", "CorrectionSession", "CorrectionTrial", "PageAddress", "SessionOptions", "serve"]
