"""Points of single frames in; pieces of paths through time out."""

from asterism.tracking.columns import ColumnRules, columns_of
from asterism.tracking.linking import LinkRules, Tracklets, find_tracklets

__all__ = ["ColumnRules", "LinkRules", "Tracklets", "columns_of", "find_tracklets"]
