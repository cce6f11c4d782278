"""3D clouds from the blobs of calibrated cameras."""
