"""Blobs of cameras with clocks of their own in; lags between cameras and blobs on a common clock out."""

from asterism.synchronization.common_clock import to_common_clock
from asterism.synchronization.lags import lags

__all__ = ["lags", "to_common_clock"]
